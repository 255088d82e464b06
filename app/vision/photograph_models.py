"""The models trained on rendered people, and their judgement of a reading.

They are trained by ``python -m scripts train-photographs``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from app.vision.blazepose import PoseReading
from app.vision.body_reading import Body3D, body_of
from app.vision.dense import DenseNetwork
from app.vision.depth import DepthModel
from app.vision.doubt import Doubt, DoubtModel, doubt_features
from app.vision.frame_posture import FramePosture, PostureModel, posture_features
from app.vision.landmark_features import region_features
from app.vision.models import FOLDER, network_path
from app.vision.network_pass import NetworkPass
from app.vision.sight import PinholeCamera
from app.vision.tflite import NetworkError

FILE = FOLDER / "photograph_models.npz"


@dataclass(frozen=True)
class Judgement:
    """The models' judgement of a reading."""

    body: Body3D
    doubt: Doubt
    posture: FramePosture


@dataclass(frozen=True)
class PhotographModels:
    """Depth, posture and doubt.

    Parameters
    ----------
    depth : DepthModel
    posture : PostureModel
    doubt : DoubtModel
    """

    depth: DepthModel
    posture: PostureModel
    doubt: DoubtModel

    def body(self, reading: PoseReading, camera: PinholeCamera) -> Body3D:
        """A reading in three dimensions; ``ValueError`` if it is not from the network."""
        given, landmarks = _given(reading), reading.landmarks
        depths = self.depth.correct(given, reading.window, camera)
        return body_of(
            given, reading.window, camera, depths, landmarks.positions, landmarks.visibility
        )

    def judge(self, reading: PoseReading, camera: PinholeCamera) -> Judgement:
        """A reading in three dimensions, how far to trust it, and its posture.

        Raises
        ------
        ValueError
            If the reading is not from the network.
        """
        body, given, landmarks = self.body(reading, camera), _given(reading), reading.landmarks
        trust = doubt_features(
            given.points[None],
            given.world[None],
            np.array([given.presence]),
            given.last[None],
            body.sigmas[None],
        )
        doubt = self.doubt.estimate(trust[0])
        box = landmarks.box()
        shape = posture_features(
            body.points[None],
            landmarks.visibility[None],
            np.array([reading.window.roll_deg]),
            np.array([reading.presence]),
            np.array([box.width / box.height]),
        )
        posture = self.posture.estimate(
            np.hstack([shape, trust])[0], region_features(given.sampled[None])[0], doubt.right
        )
        return Judgement(body, doubt, posture)


def _given(reading: PoseReading) -> NetworkPass:
    if reading.network_pass is None:
        raise ValueError("expected a reading with its pass of the network, got one without")
    return reading.network_pass


@cache
def photograph_models(path: Path | None = None) -> PhotographModels:
    """Load models once: the shipped ones, or those in another file.

    Raises
    ------
    NetworkError
        If the file is missing or holds something else.
    """
    path = network_path("photograph_models") if path is None else path
    try:
        with np.load(path) as stored:
            arrays = dict(stored)
        names = ("depth", "doubt", "posture.by_body", "posture.by_surroundings")
        depth, doubt, by_body, by_surroundings = (DenseNetwork.of(arrays, name) for name in names)
        trust = np.asarray(arrays["posture.trust"], np.float64)
    except (OSError, KeyError, ValueError) as error:
        raise NetworkError(f"cannot read the models in {path}: {error}") from error
    posture = PostureModel(by_body, by_surroundings, trust)
    return PhotographModels(DepthModel(depth), posture, DoubtModel(doubt))
