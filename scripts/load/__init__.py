"""Clients and measurements of a running server."""
