"""Render people as photographs that the service reads in three views: see ``docs/training.md``.

A photograph is read as it is; with the body cut off or covered; and in bad light, half of them
covered as well. Writes ``rows-NNNN.npz``, 500 photographs each: what shows the posture (see
:class:`app.vision.judgement.PostureEvidence`), and the truth. The same bytes come out for the same
seed; files that are there are not made again.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from app.networks.shipped import file_of
from app.vision.blazepose import LandmarkNetwork, MaskNetwork
from app.vision.geometry import Box
from app.vision.judgement import PhotographModels, load_photograph_models
from app.vision.movenet import KeypointReader, MoveNet
from app.vision.optics import ASSUMED_FOV_DEG, PinholeCamera
from app.vision.people import Detection
from app.vision.person_reader import PersonReader
from scripts.training.photograph_data import Rows
from scripts.training.render.scene import EMPTY, Photograph
from scripts.training.render.views import hide, spoil
from scripts.training.render_people import open_studio, rendering_parser, write_rows

VIEWS = ("plain", "hidden", "spoilt")


@dataclass(frozen=True)
class PostureRows(Rows):
    """The evidence for the postures of rendered people, and the true postures."""

    photograph: NDArray[np.int64]  # (N,)
    view: NDArray[np.int64]  # (N,): positions in :data:`VIEWS`
    body: NDArray[np.float16]  # (N, F)
    surroundings: NDArray[np.float16]  # (N, M)
    right: NDArray[np.float64]  # (N,): probability that the landmarks are right
    presence: NDArray[np.float64]  # (N,)
    # (N,): positions in :data:`app.vision.judgement.FRAME_POSTURES`, or -1 where nobody is.
    posture: NDArray[np.int64]


def views_of(photograph: Photograph, generator: Generator) -> Iterator[Photograph]:
    """The photograph in each of :data:`VIEWS`; nobody is hidden in one that shows nobody."""
    hidden = photograph if photograph.posture == EMPTY else hide(photograph, generator)
    yield photograph
    yield hidden
    either = hidden if generator.random() < 0.5 else photograph
    yield replace(either, image=spoil(either.image, generator))


def camera_of(photograph: Photograph, generator: Generator) -> PinholeCamera:
    """The camera as the service knows it: half of them are assumed."""
    if generator.random() < 0.5:
        return PinholeCamera(photograph.focal, photograph.centre, given=True)
    focal = photograph.frame_px.max() / 2 / np.tan(np.deg2rad(ASSUMED_FOV_DEG) / 2)
    return PinholeCamera(np.array([focal, focal]), photograph.centre)


def rough_box(photograph: Photograph, generator: Generator) -> Box:
    """The box about what is seen of the subject, as roughly as detectors find it."""
    scatter = generator.normal(0, 0.04, 4) * photograph.box[[2, 3, 2, 3]]
    left, top, width, height = (photograph.box + scatter).tolist()
    return Box(left, top, max(4.0, width), max(4.0, height))


@dataclass(frozen=True)
class Reader:
    """The service's reading of one person, and its models of photographs."""

    people: PersonReader
    models: PhotographModels

    @classmethod
    def load(cls) -> Self:
        """With the networks that ship."""
        models = load_photograph_models()
        people = PersonReader(
            LandmarkNetwork(file_of("pose_landmarks")),
            MaskNetwork(file_of("pose_mask")),
            KeypointReader(MoveNet(file_of("movenet"))),
            models,
        )
        return cls(people, models)

    def rows(self, number: int, photograph: Photograph, generator: Generator) -> PostureRows:
        """The rows of the views of a photograph."""
        rows = []
        for view, shown in enumerate(views_of(photograph, generator)):
            found = Detection(rough_box(shown, generator), 1.0)
            camera = camera_of(shown, generator)
            reading = self.people.read(shown.image, camera, found)
            _, trust, seen = self.models.evidence(reading, camera)
            one = (number, view, seen.body, seen.surroundings, trust.right, reading.presence)
            rows.append([np.array([value]) for value in (*one, shown.posture)])
        columns = [np.concatenate(column) for column in zip(*rows, strict=True)]
        return PostureRows(
            *columns[:2], *(part.astype(np.float16) for part in columns[2:4]), *columns[4:]
        )


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = rendering_parser(__doc__, count=16_000, seed=11)
    options = parser.parse_args(arguments)
    if options.out is None:
        parser.error("expected --out")
    write_rows(options, open_studio(options), Reader.load().rows)
