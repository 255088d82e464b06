"""Whose turn it is, threads, deadlines, cores. Imports nothing of the service."""
