"""People who stand in front of others: what they cover, and where the hidden ones are expected."""

from collections.abc import Sequence

from app.tracking.track import Track
from app.vision.geometry import Box

# A person who is hidden behind another one is expected for so long.
PREDICTED_FOR_S = 2.0
# Share of a person's box that another must cover to hide them.
_HIDDEN_SHARE = 0.5


def covered_share(track: Track, place: Box, tracks: Sequence[Track], timestamp: float) -> float:
    """Largest share of a person's place that another person covers who is seen in this frame.

    Others count once they have an identity.
    """
    others = (
        other.box_filter.seen.intersection(place) / place.area
        for other in tracks
        if other is not track and other.track_id is not None and other.seen_at == timestamp
    )
    return max(others, default=0.0)


def hidden_box(
    track: Track, tracks: Sequence[Track], size: tuple[int, int], timestamp: float
) -> Box | None:
    """Where a person is expected whom another one hides; None if nobody does, or for too long.

    ``size`` is the height and width of the frame, pixels.
    """
    if timestamp - track.seen_at > PREDICTED_FOR_S:
        return None
    height, width = size
    box = track.box_filter.predict(timestamp).clip(width, height)
    if box is None:
        return None
    others = (
        other.box_filter.predict(timestamp)
        for other in tracks
        if other is not track and other.seen_at == timestamp
    )
    hides = any(other.intersection(box) >= _HIDDEN_SHARE * box.area for other in others)
    return box if hides else None
