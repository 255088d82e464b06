"""The running service: its state, the index loaded and followed, logs. Imports http and below."""
