"""The public contract: schemas, replies, overlays. Imports tracking and below."""
