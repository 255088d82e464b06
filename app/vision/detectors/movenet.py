"""MoveNet as a detector of people of any size."""

from dataclasses import dataclass

from app.vision.detectors.tiles import Picture
from app.vision.movenet import MoveNet
from app.vision.people import Detection

MIN_MOVENET_SCORE = 0.02
"""MoveNet's lower scores are ignored."""

# Longer side of a box, in the overview, from which people are taken from the overview; smaller ones
# are taken from the tiles, which separate two people side by side.
_LARGE_PERSON_PX = 96.0


@dataclass(frozen=True)
class MoveNetDetector:
    """Detects people with keypoints, in the overview and the tiles of a picture; thread-safe."""

    network: MoveNet

    def detect(self, picture: Picture) -> list[Detection]:
        """Detect people: first those in the tile that suits their size, by their scores.

        A person may be detected more than once.
        """
        found: list[tuple[float, Detection]] = []
        for number, tile in enumerate(picture.tiles):
            for person in self.network.detect(picture.seen_in(tile)):
                box = tile.to_frame(person.box, picture.frame.shape)
                if box is None or person.score < MIN_MOVENET_SCORE:
                    continue
                score = min(1.0, person.score)
                keypoints = person.keypoints.scaled(1 / tile.factor).moved(*tile.rect[:2])
                overview_px = max(box.width, box.height) * picture.tiles[0].factor
                is_large = overview_px >= _LARGE_PERSON_PX
                suits = len(picture.tiles) == 1 or is_large == (number == 0)
                found.append((score + suits, Detection(box, score, keypoints)))
        return [one for _, one in sorted(found, key=lambda pair: -pair[0])]
