"""Whose turn it is, threads, deadlines, processes. Imports vision only."""
