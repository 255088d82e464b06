"""The running service: its state, its index, the work on videos. Imports http and below."""
