"""The public contract: schemas, replies, COCO formats, overlays. Imports tracking and below."""
