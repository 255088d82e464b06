"""The models that rendered people teach, and what they make of a reading.

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
from app.vision.models import FOLDER, network_path
from app.vision.network_pass import NetworkPass
from app.vision.sight import PinholeCamera
from app.vision.tflite import NetworkError

FILE = FOLDER / "photograph_models.npz"


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
        """A reading in three dimensions; ``ValueError`` where no network read it."""
        given, landmarks = _given(reading), reading.landmarks
        depths = self.depth.correct(given, reading.window, camera)
        return body_of(
            given, reading.window, camera, depths, landmarks.positions, landmarks.visibility
        )

    def frame_posture(self, reading: PoseReading, body: Body3D, doubt: Doubt) -> FramePosture:
        """The posture of a reading whose body and doubt are known."""
        box = reading.landmarks.box()
        features = posture_features(
            body.points[None],
            reading.landmarks.visibility[None],
            np.array([reading.window.roll_deg]),
            np.array([reading.presence]),
            np.array([box.width / box.height]),
        )
        return self.posture.estimate(features[0], doubt.right)

    def doubts(self, reading: PoseReading, body: Body3D) -> Doubt:
        """How far to trust a reading whose body is known."""
        given = _given(reading)
        features = doubt_features(
            given.points[None],
            given.world[None],
            np.array([given.presence]),
            given.last[None],
            body.sigmas[None],
        )
        return self.doubt.estimate(features[0])


def _given(reading: PoseReading) -> NetworkPass:
    if reading.network_pass is None:
        raise ValueError("expected a reading with its pass of the network, got one without")
    return reading.network_pass


@cache
def photograph_models(path: Path | None = None) -> PhotographModels:
    """Load models once: those that ship, or those of another file.

    Raises
    ------
    NetworkError
        If the file is missing or holds something else.
    """
    path = network_path("photograph_models") if path is None else path
    try:
        with np.load(path) as stored:
            arrays = dict(stored)
        names = ("depth", "posture", "doubt")
        depth, posture, doubt = (DenseNetwork.of(arrays, name) for name in names)
        trust = np.asarray(arrays["posture.trust"], np.float64)
    except (OSError, KeyError, ValueError) as error:
        raise NetworkError(f"cannot read the models in {path}: {error}") from error
    return PhotographModels(DepthModel(depth), PostureModel(posture, trust), DoubtModel(doubt))
