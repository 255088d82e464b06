"""Occlusion of people by others: the covered share, and the expected place of a hidden person."""

from collections.abc import Sequence

from app.tracking.track import Track
from app.vision.geometry import Box

# Time for which the place of a hidden person is predicted.
PREDICTED_FOR_S = 2.0


def covered_share(track: Track, place: Box, tracks: Sequence[Track], timestamp: float) -> float:
    """Largest share of a person's place that a single other person covers.

    Others count if this frame shows them and they have an identity.
    """
    others = (
        other.box_filter.seen.intersection(place) / place.area
        for other in tracks
        if other is not track and other.track_id is not None and other.seen_at == timestamp
    )
    return max(others, default=0.0)


def hidden_box(
    track: Track, tracks: Sequence[Track], frame_shape: tuple[int, ...], timestamp: float
) -> Box | None:
    """Expected place of a hidden person; None if no other hides them, or after too long a time."""
    if timestamp - track.seen_at > PREDICTED_FOR_S:
        return None
    height, width = frame_shape[:2]
    box = track.box_filter.predict(timestamp).clip(width, height)
    if box is None:
        return None
    others = (
        other.box_filter.predict(timestamp)
        for other in tracks
        if other is not track and other.seen_at == timestamp
    )
    # Share of a person's box that another must cover to hide them.
    hides = any(other.intersection(box) >= 0.5 * box.area for other in others)
    return box if hides else None
