"""MoveNet as a detector of people of any size."""

from collections.abc import Iterable
from dataclasses import dataclass

from app.vision.detectors.tiles import Picture, Tile
from app.vision.movenet import MoveNet
from app.vision.people import Detection

MIN_MOVENET_SCORE = 0.02
"""Least score of MoveNet that counts."""

# Longer side of a box, in the overview, from which people are taken from the overview. Smaller
# people are taken from the tiles, which separate two people side by side.
_LARGE_PERSON_PX = 96.0

# Longer side of a small picture of the frame, a tenth of the overview's area, that is searched for
# people who fill the frame: the network recognises them at this size, and hardly in the overview.
_GLANCE_PX = 192.0
# Share of the frame's longer side from which a person fills it.
_FILLING_SHARE = 0.5
# Score of a person from which the frame is not searched at that size.
_SURE_SCORE = 0.3


@dataclass(frozen=True)
class MoveNetDetector:
    """Detects people with keypoints, in the overview and the tiles of a picture; thread-safe.

    ``small`` is another copy of the network for small pictures, since one that is given pictures of
    other sizes in turn takes a tenth more time.
    """

    network: MoveNet
    small: MoveNet

    def detect(self, picture: Picture) -> list[Detection]:
        """Detect people; detections in the tile that suits their size come first, by score.

        A person may be detected more than once.
        """
        found: list[tuple[float, Detection]] = []
        for number, tile in enumerate(picture.tiles):
            for one in _seen_in(self.network, picture, tile):
                is_large = _longer_side(one, picture) >= _LARGE_PERSON_PX
                suits = len(picture.tiles) == 1 or is_large == (number == 0)
                found.append((one.score + suits, one))
        if all(one.score < _SURE_SCORE for _, one in found):
            nearer = _seen_in(self.small, picture, _glance(picture))
            found += [(one.score + 1, one) for one in _filling(nearer, picture)]
        return [one for _, one in sorted(found, key=lambda pair: -pair[0])]


def _seen_in(network: MoveNet, picture: Picture, tile: Tile) -> list[Detection]:
    """People that the network finds in a tile, in pixels of the frame."""
    seen = []
    for person in network.detect(picture.seen_in(tile)):
        box = tile.to_frame(person.box, picture.frame.shape)
        if box is not None and person.score >= MIN_MOVENET_SCORE:
            keypoints = person.keypoints.scaled(1 / tile.factor).moved(*tile.rect[:2])
            seen.append(Detection(box, min(1.0, person.score), keypoints))
    return seen


def _longer_side(one: Detection, picture: Picture) -> float:
    """The longer side of a box as the overview shows it."""
    return max(one.box.width, one.box.height) * picture.tiles[0].factor


def _filling(people: Iterable[Detection], picture: Picture) -> list[Detection]:
    """People who fill the frame."""
    large = _FILLING_SHARE * max(picture.tiles[0].size)
    return [one for one in people if _longer_side(one, picture) >= large]


def _glance(picture: Picture) -> Tile:
    """The whole frame at a small size."""
    whole = picture.tiles[0]
    return Tile(whole.rect, whole.factor * min(1.0, _GLANCE_PX / max(whole.size)))
