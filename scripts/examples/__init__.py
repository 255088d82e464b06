"""Clients and uses of the service, to start from."""
