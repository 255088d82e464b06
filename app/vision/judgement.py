"""Small models that judge a reading: the body in space, how far to trust it, and its posture.

They were trained on rendered people, depth and trust by ``python -m scripts train-photographs``,
postures by ``train-postures``. Trust is the probability that the window shows a person, and that
their landmarks are right. The posture is one of six that a single frame distinguishes, with a
probability for each.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from app.networks.dense import DenseNetwork
from app.networks.probabilities import log_odds, logit, probability_of, sigmoid, softmax
from app.networks.shipped import NetworkError, arrays_of, read_arrays
from app.vision.blazepose import LANDMARK_PX, LANDMARKS, PoseReading
from app.vision.depth import HIPS, Body3D, DepthModel, body_of
from app.vision.optics import PinholeCamera
from app.vision.people import LANDMARK_NAMES, landmark_rows


@dataclass(frozen=True)
class Trust:
    """How far to trust a reading."""

    # Probability that the window shows a person, for prior odds of 1:1.
    person: float
    # Probability that it does and that at least three quarters of the visible limb joints lie
    # within a fifth of the trunk of their true places, for windows like those in training.
    right: float

    @property
    def is_person(self) -> bool:
        return self.person >= 0.5

    @property
    def is_right(self) -> bool:
        return self.right >= 0.5


FRAME_POSTURES = "standing", "bending", "crouching", "sitting", "all_fours", "lying"


@dataclass(frozen=True)
class FramePosture:
    """Probability ``(6,)`` of each of :data:`FRAME_POSTURES`; they sum to 1."""

    probabilities: NDArray[np.float64]

    def __post_init__(self) -> None:
        if self.probabilities.shape != (len(FRAME_POSTURES),):
            raise ValueError(f"expected six probabilities, got {self.probabilities.shape}")

    def of(self, name: str) -> float:
        return float(self.probabilities[FRAME_POSTURES.index(name)])


@dataclass(frozen=True, kw_only=True)
class JudgedReading(PoseReading):
    """A reading, and the models' judgement of it."""

    body: Body3D
    trust: Trust
    posture: FramePosture


@dataclass(frozen=True)
class PostureEvidence:
    """What postures are estimated from."""

    body: NDArray[np.float64]  # (F,): :func:`posture_features` and :func:`trust_features`
    surroundings: NDArray[np.float32]  # (M,): :func:`region_features`


@dataclass(frozen=True)
class PhotographModels:
    """The models of depth, trust and posture."""

    depth: DepthModel
    trust: TrustModel
    posture: PostureModel

    def body(self, reading: PoseReading, camera: PinholeCamera) -> Body3D:
        return body_of(reading, camera, self.depth.correct(reading, camera))

    def judge(self, reading: PoseReading, camera: PinholeCamera) -> JudgedReading:
        """A reading in three dimensions, how far to trust it, and its posture."""
        body, trust, evidence = self.evidence(reading, camera)
        posture = self.posture.estimate(evidence, trust.right)
        given = {field.name: getattr(reading, field.name) for field in fields(PoseReading)}
        return JudgedReading(**given, body=body, trust=trust, posture=posture)

    def evidence(
        self, reading: PoseReading, camera: PinholeCamera
    ) -> tuple[Body3D, Trust, PostureEvidence]:
        """A reading in three dimensions, how far to trust it, and what shows its posture."""
        body, landmarks = self.body(reading, camera), reading.landmarks
        given = reading.network_pass
        trusted = trust_features(
            given.points[None],
            given.world[None],
            np.array([given.presence]),
            given.last[None],
            body.sigmas[None],
        )[0]
        box = landmarks.box()
        shape = posture_features(
            body.points,
            landmarks.visibility,
            reading.window.roll_deg,
            reading.presence,
            box.width / box.height,
        )
        evidence = PostureEvidence(np.concatenate([shape, trusted]), region_features(given.sampled))
        seen = np.concatenate([trusted, evidence.surroundings])
        return body, self.trust.estimate(seen), evidence


def load_photograph_models(path: Path | None = None) -> PhotographModels:
    """Load the models that ship, or those in another file.

    Raises
    ------
    NetworkError
        If the file is missing or holds something else.
    """
    arrays = arrays_of("photograph_models") if path is None else read_arrays(path)
    try:
        depth, trust, posture = (DenseNetwork.of(arrays, n) for n in ("depth", "trust", "posture"))
        sharpness = np.asarray(arrays["posture.sharpness"], np.float64)
        moments = np.asarray(arrays["depth.moments"], np.float64)
    except (KeyError, ValueError) as error:
        raise NetworkError(f"expected models of photographs in {path}: {error}") from error
    return PhotographModels(
        DepthModel(depth, moments), TrustModel(trust), PostureModel(posture, sharpness)
    )


_SHOULDERS, _KNEES, _ANKLES, _WRISTS, _EARS = (
    landmark_rows(part) for part in ("shoulder", "knee", "ankle", "wrist", "ear")
)
_LIMBS = landmark_rows("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
_FACE = [LANDMARK_NAMES.index("nose"), *_EARS]


PEOPLE_SHARE = 6 / 7
"""Weight of the windows in training that show a person."""


@dataclass(frozen=True)
class TrustModel:
    """Estimates how far to trust readings from :func:`trust_features` and :func:`region_features`.

    The network gives the log odds of a person, and of right landmarks where there is one.
    """

    network: DenseNetwork

    def probabilities(self, features: NDArray[np.float64]) -> NDArray[np.float64]:
        """Probabilities ``(N, 2)``: a person; a person whose landmarks are right.

        They are those of windows as in training, which mostly show people.
        """
        given = sigmoid(self.network(features).astype(np.float64))
        return np.column_stack([given[:, 0], given[:, 0] * given[:, 1]])

    def estimate(self, features: NDArray[np.float64]) -> Trust:
        person, right = self.probabilities(features[None])[0]
        odds = logit(person, 1e-6) - log_odds(PEOPLE_SHARE)
        return Trust(probability_of(float(odds)), float(right))


def trust_features(
    points: NDArray[np.floating],
    world: NDArray[np.floating],
    presence: NDArray[np.floating],
    last: NDArray[np.floating],
    sigmas: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Inputs of the model: ``(N, F)``.

    Parameters
    ----------
    points : (N, 39, 5) array
    world : (N, 39, 3) array
    presence : (N,) array
    last : (N, 2, 2, 288) array
        The fields of :class:`app.vision.blazepose.NetworkPass`.
    sigmas : (N, 33) float64 array
        Sigmas of the corrected depths.
    """
    points, metres = points.astype(np.float64), world[:, :LANDMARKS].astype(np.float64)
    places = points[:, :LANDMARKS, :2] / LANDMARK_PX - 0.5
    visibility = sigmoid(points[:, :LANDMARKS, 3])
    odds = np.clip(points[:, :LANDMARKS, 3], -8, 8)
    sure = np.clip(presence.astype(np.float64), 1e-5, 1 - 1e-5)
    # The window that the network would look at next, relative to this one.
    centre, towards = points[:, 33, :2] / LANDMARK_PX - 0.5, points[:, 34, :2] / LANDMARK_PX - 0.5
    arm = towards - centre
    radius = np.linalg.norm(arm, axis=1)
    # Lengths in the picture relative to lengths in metres: for one body, the scale is the same.
    flat = np.linalg.norm(metres[..., :2] - metres[:, HIPS, :2].mean(1, keepdims=True), axis=-1)
    seen = np.linalg.norm(places - places[:, HIPS].mean(axis=1, keepdims=True), axis=-1)
    scale = seen.sum(axis=1) / np.maximum(flat.sum(axis=1), 1e-3)
    misfit = np.abs(seen - scale[:, None] * flat).mean(axis=1)
    trunk = metres[:, _SHOULDERS].mean(axis=1) - metres[:, HIPS].mean(axis=1)
    return np.column_stack(
        [
            np.log(sure / (1 - sure)),
            np.linalg.norm(centre, axis=1),
            np.log(np.maximum(radius, 1e-3) / 0.4),
            arm[:, 0] / np.maximum(radius, 1e-3),
            -arm[:, 1] / np.maximum(radius, 1e-3),
            visibility[:, _LIMBS].mean(axis=1),
            visibility[:, _LIMBS].min(axis=1),
            visibility[:, _FACE].mean(axis=1),
            odds[:, _LIMBS].mean(axis=1),
            np.log(sigmas[:, _LIMBS]).mean(axis=1),
            np.log(sigmas[:, _LIMBS]).max(axis=1),
            np.ptp(places[:, _LIMBS], axis=1).max(axis=1),
            np.linalg.norm(trunk, axis=1),
            misfit,
            np.clip(points[:, _LIMBS, 4], -8, 8).mean(axis=1),
            last.reshape(len(points), 4, -1).mean(axis=1, dtype=np.float64),
        ]
    )


@dataclass(frozen=True)
class PostureModel:
    """Estimates postures."""

    network: DenseNetwork  # scores of :data:`FRAME_POSTURES`
    # (2,): the scores are multiplied by a factor: the less of a person is seen, the less certain is
    # the posture. These are the factor's logarithm if landmarks are as likely right as wrong, and
    # its growth with the log odds of right landmarks. Both are calibrated on held-out renders.
    sharpness: NDArray[np.float64]

    def scores(
        self, body: NDArray[np.float64], surroundings: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Scores ``(N, 6)`` of features of bodies ``(N, F)`` and their surroundings ``(N, M)``."""
        return np.asarray(self.network(np.hstack([body, surroundings])), np.float32)

    def estimate(self, evidence: PostureEvidence, right: float) -> FramePosture:
        """Posture of a person, with the probability that their landmarks are right."""
        scores = self.scores(evidence.body[None], evidence.surroundings[None])
        return FramePosture(sharpened(scores, np.array([right]), self.sharpness)[0])


def sharpened(
    scores: NDArray[np.floating], right: NDArray[np.float64], sharpness: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Probabilities ``(N, O)`` of scores, see :class:`PostureModel`."""
    # The probability that landmarks are right is kept this far from 0 and 1.
    factors = np.exp(sharpness[0] + sharpness[1] * logit(right, 0.01))
    return softmax(scores * factors[:, None])


_TRUNK, _LEGS = landmark_rows("shoulder", "hip"), landmark_rows("knee", "ankle")


def region_features(sampled: NDArray[np.floating]) -> NDArray[np.float32]:
    """Means over the trunk and the legs ``(..., 2 C)`` of a map at the landmarks ``(..., 33, C)``.

    They show what surrounds a body, such as a seat, a blanket, or a table in front of the legs.
    """
    means = [sampled[..., rows, :].astype(np.float32).mean(axis=-2) for rows in (_TRUNK, _LEGS)]
    return np.concatenate(means, axis=-1)


_EXTENT = [*_SHOULDERS, *HIPS, *_KNEES, *_ANKLES, *_EARS]


def posture_features(
    points: NDArray[np.float64],
    visibility: NDArray[np.float64],
    roll_deg: float,
    presence: float,
    box_aspect: float,
) -> NDArray[np.float64]:
    """The shape of a body ``(F,)``; it does not distinguish left from right.

    Parameters
    ----------
    points : (33, 3) float64 array
        Landmarks, metres, camera axes: y down.
    visibility : (33,) float64 array
    roll_deg : float
        Of the window.
    presence : float
        As the network gives it.
    box_aspect : float
        Width over height of the box about the landmarks.
    """

    def middle(rows: list[int]) -> NDArray[np.float64]:
        return np.asarray(points[rows].mean(axis=0))

    trunk = middle(_SHOULDERS) - middle(HIPS)
    thighs = points[_KNEES] - points[HIPS]
    shanks = points[_ANKLES] - points[_KNEES]
    head = middle(_EARS) - middle(_SHOULDERS)
    hip = _unit(thighs) @ _unit(trunk)
    knee = (_unit(thighs) * _unit(shanks)).sum(axis=1)
    legs = np.linalg.norm(thighs, axis=1).mean() + np.linalg.norm(shanks, axis=1).mean()
    legs = max(legs, 0.2)
    heights = -points[:, 1]
    lowest = heights[_EXTENT].min()
    extent = np.ptp(points[_EXTENT], axis=0)
    roll = np.deg2rad(roll_deg)
    thigh, shank = thighs.mean(axis=0), shanks.mean(axis=0)
    return np.array(
        [
            *(slope for bone in (trunk, thigh, shank, head) for slope in _slopes(bone)),
            *np.sort(-_unit(thighs)[:, 1]),
            *np.sort(-_unit(shanks)[:, 1]),
            *(_unit(bone)[2] for bone in (trunk, thigh, shank)),
            *np.sort(hip),
            *np.sort(knee),
            extent[1],
            np.log((extent[1] + 0.05) / (np.hypot(extent[0], extent[2]) + 0.05)),
            (heights[HIPS].mean() - lowest) / legs,
            (heights[_SHOULDERS].mean() - lowest) / legs,
            (heights[_WRISTS].min() - lowest) / legs,
            (heights[_KNEES].min() - lowest) / legs,
            np.sin(roll),
            np.cos(roll),
            presence,
            np.log(np.clip(box_aspect, 0.05, 20)),
            visibility[_KNEES].max(),
            visibility[_ANKLES].max(),
            visibility[HIPS].max(),
        ]
    )


def _slopes(bone: NDArray[np.float64]) -> tuple[float, float]:
    """Sine of the elevation of a bone ``(3,)``, and its complement."""
    sine = -float(_unit(bone)[1])
    return sine, np.sqrt(max(1 - sine**2, 0.0))


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.maximum(lengths, 1e-6))
