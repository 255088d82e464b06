"""What a photograph shows of people's joints: the network, and what it says of one person."""
