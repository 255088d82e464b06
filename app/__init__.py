"""The service: HTTP, images and the one use case, a frame in, persons with hypotheses out."""

import os

# Requests run side by side, one thread each. Threads inside NumPy's and FAISS' products would
# only fight over the same cores, and FAISS answers a single query slower and inexactly with
# them. Both read this when they are imported.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# A caller's broken image is answered with a 400; OpenCV's own word on it would fill the log.
os.environ.setdefault("OPENCV_LOG_LEVEL", "OFF")
