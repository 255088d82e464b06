"""Videos, decoded in processes of their own. Imports scheduling and below."""

MIN_STEP_S = 1e-3
"""Seconds from one frame to the next; closer ones have no order that a camera could have seen."""
