"""Training of the networks, models and constants of the service."""
