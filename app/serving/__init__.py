"""The running service: its state, and the index that it loads. Imports http and below."""
