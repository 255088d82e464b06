"""Images only: decode them, detect people, read each person, cut out silhouettes.

Throughout this package an image is BGR, ``(H, W, 3)`` uint8. The origin of pixels is the centre of
the top-left one, x points right, y down. Nothing of the service is imported.
"""

import os

# OpenCV reads this when it is imported: a second line of defence behind the size check of
# `app.vision.images`, for images whose decoder disagrees with their header.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(2**27))
