"""Silhouette to vector: normalisation, Krawtchouk moments, descriptors. NumPy only."""
