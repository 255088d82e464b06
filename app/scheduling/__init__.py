"""The queue, threads, deadlines, cores. Imports nothing of the service."""
