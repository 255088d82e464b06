"""How the network that reads which way a person faces is made, and what it is worth."""
