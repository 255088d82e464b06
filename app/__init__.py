"""The service: photographs, cameras and videos in, people with their poses and events out."""

import os
from importlib.metadata import PackageNotFoundError, version

# Frames are worked on in parallel. Threads within NumPy and FAISS would only compete for the same
# cores, and make FAISS slower and inexact for a single query. Both read this when imported.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# A broken image is answered with a 400; OpenCV's own messages would fill the log.
os.environ.setdefault("OPENCV_LOG_LEVEL", "OFF")
# A second line of defence behind the size check of `app.vision.images`, for images whose decoder
# disagrees with their header.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(2**27))

try:
    VERSION = version("silhouette-pose")
except PackageNotFoundError:  # The checkout was never installed.
    VERSION = "0.0.0"
