"""Silhouette to vector: normalisation, Krawtchouk moments, descriptors. NumPy and OpenCV only."""
