"""Boxes to silhouettes: the network's, those of a background plate, and a caller's own."""
