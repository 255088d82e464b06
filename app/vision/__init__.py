"""Images only: decode them, detect people, read each person, cut out silhouettes.

Throughout this package an image is BGR, ``(H, W, 3)`` uint8. The origin of pixel coordinates is the
centre of the top-left pixel; x points right, y down. This package imports nothing of the service.
"""
