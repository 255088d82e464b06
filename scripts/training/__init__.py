"""What the networks, models and constants of the service are learned with."""
