"""The public contract: schemas, replies, COCO forms, overlays. Imports tracking and below."""
