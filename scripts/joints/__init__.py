"""How the network that reads joints is made, and what it is worth."""
