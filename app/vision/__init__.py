"""Images only: decode them, detect people, read each person, cut out silhouettes.

Throughout this package an image is BGR, ``(H, W, 3)`` uint8. The origin of pixels is the centre of
the top-left one, x points right, y down. Nothing of the service is imported.
"""
