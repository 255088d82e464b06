"""Images only: decode, detect, read each person, cut out. Imports nothing of the service.

Everywhere in this package an image is BGR, ``(H, W, 3)`` uint8, and pixels have their
origin at the centre of the top-left pixel, x right, y down.
"""

import os
from typing import Literal

DetectorName = Literal["network", "hog"]

# OpenCV reads this when it is imported: a second line of defence behind the size check of
# `decode`, for images whose decoder disagrees with their header.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(2**27))
