"""The floor of a camera's view, learnt from people who stand on it, and whether others lie on it.

Where feet and heads of people of about the same height appear shows how high the camera hangs, how
it is tilted and how wide it sees. A body is as far away as its size in the picture says: on a bed,
it is nearer to the camera than the floor that is seen beside it.
"""

from __future__ import annotations

import math
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from app.estimation.results import Person
from app.vision.optics import PinholeCamera, place_on_sight_lines, to_line_of_sight
from app.vision.people import Landmarks, landmark_rows

_PARTS = [landmark_rows(part) for part in ("ear", "shoulder", "hip", "knee", "ankle")]
_EARS, _SHOULDERS, _HIPS, _, _ANKLES = _PARTS

# Heights of ears and hips over the ankles, metres as the landmark network gives them.
_EARS_M, _HIPS_M = 1.5, 0.84
# Standard deviations of sightings: where the head is, across and along the body, in heights of the
# body; the logarithm of the distance by its size; the elevation, radians.
_NOISE = np.array([0.06, 0.07, 0.12, np.deg2rad(8)])
_INDEPENDENT = 0.5  # Of two sightings, one counts: errors last.
# Residuals from which a sighting is rather wrong, standard deviations.
_WRONG_FROM = 2.0

# Means and standard deviations of cameras and people: tilt and roll, radians; logarithms of the
# height over the ankles in metres, of the focal length over the assumed one, and of a body's size.
_USUAL = np.array([np.deg2rad(20), 0.0, np.log(2.2), -0.1])
_USUAL_SD = np.array([np.deg2rad(25), np.deg2rad(4), 0.6, 0.3])
_SIZE_SD = 0.07

# If so many new sightings lie so many standard deviations away, the camera was moved.
_MOVED_AFTER, _MOVED_FROM = 6, 3.0


class Height(NamedTuple):
    """How high a body is over the ankles of those who stand, and its deviation (1 sd), metres."""

    mean: float
    sd: float


class Rest:
    """Whether one person lies on the floor, by the frames of the last second in which they lie."""

    def __init__(self) -> None:
        self._frames, self._height, self._at = 0.0, Height(0.0, 0.0), -math.inf

    def update(self, timestamp: float, person: Person, who: int, floor: Floor) -> None:
        # Frames count for a second: people fall out of bed.
        self._frames *= math.exp(self._at - timestamp)
        self._at = timestamp
        posture, trust, landmarks = person.frame_posture, person.trust, person.landmarks
        if posture is None or trust is None or landmarks is None:
            return
        if posture.of("lying") < 0.5 or trust.right < 0.1:
            return
        if (height := floor.height(who, landmarks)) is None:
            return
        self._frames += trust.right
        share = trust.right / self._frames
        self._height = Height(
            *(a + share * (b - a) for a, b in zip(self._height, height, strict=True))
        )

    @property
    def on_floor(self) -> float | None:
        """Probability that the person lies on the floor; None while nobody can tell."""
        on_floor = self._probability
        return on_floor if max(on_floor, 1 - on_floor) >= 0.8 else None

    @property
    def odds(self) -> float:
        """Odds of the floor against a bed, as far as they can be relied on; 1 if unknown."""
        on_floor = self._probability
        # The floor itself may be wrong.
        return min(max(on_floor / max(1 - on_floor, 1e-9), 1 / 4), 4.0)

    @property
    def _probability(self) -> float:
        """Probability that the person lies on the floor; one half if unknown."""
        mean, sd = self._height
        # Beyond these heights, metres, the reading or the floor must be wrong.
        if self._frames < 0.8 or not -0.6 < mean < 1.2:
            return 0.5
        # As likely on the floor as on a bed at this height; chosen on the real films and on
        # simulated rooms with beds of 0.3 to 0.7 m.
        return NormalDist(mean, sd).cdf(0.35)


class Calibration(NamedTuple):
    """A camera over a floor, and the people who showed it.

    The mean ``(4 + P,)`` and the covariance are of tilt and roll, radians, of the logarithms of the
    height in metres and of the focal length over the assumed one, and of the people's sizes.
    """

    mean: NDArray[np.float64]
    covariance: NDArray[np.float64]
    people: tuple[int, ...]
    misfit: NDArray[np.float64]  # (N,): of each sighting, standard deviations


class Floor:
    """Learns the floor of one camera; memory is bounded."""

    def __init__(self) -> None:
        self._camera: PinholeCamera | None = None
        self.forget()

    def forget(self) -> None:
        """Begin again, as for a camera that was moved."""
        self._seen: list[tuple[int, NDArray[np.float64]]] = []
        self._calibration: Calibration | None = None

    def watch(self, camera: PinholeCamera) -> None:
        before, self._camera = self._camera, camera
        if before is not None and not (
            np.array_equal(before.focal, camera.focal) and before.given == camera.given
        ):
            self.forget()

    def see(self, who: int, person: Person, frame_shape: tuple[int, ...]) -> None:
        """Learn from a person if they stand and are seen from head to foot."""
        landmarks = person.landmarks
        if landmarks is None or self._camera is None or not _stands(person, frame_shape):
            return
        rays = self._camera.rays(landmarks.positions)
        feet, head, hips = (rays[rows, :2].mean(axis=0) for rows in (_ANKLES, _EARS, _HIPS))
        nearness = 1 / float(_placed(landmarks, rays)[_HIPS, 2].mean())
        # The body is upright, so its slope along the line of sight is the camera's.
        up = landmarks.metres[_SHOULDERS].mean(axis=0) - landmarks.metres[_ANKLES].mean(axis=0)
        elevation = np.arctan2(-up[2], -up[1])
        row = np.array([*feet, *head, *hips, nearness, elevation])
        # Those who stand still shall not outweigh those who walk: of three sightings of a person
        # in about the same place, the oldest is replaced.
        reach = 0.15 * _EARS_M * nearness
        alike = [
            number
            for number, (other, known) in enumerate(self._seen)
            if other == who and np.linalg.norm(known[:2] - feet) < reach
        ]
        if len(alike) >= 3:
            del self._seen[alike[0]]
        elif len(self._seen) >= 48:  # Everybody's size stays known.
            people = [one for one, _ in self._seen]
            del self._seen[people.index(max(people, key=people.count))]
        self._seen.append((who, row))
        self._calibration = None

    @property
    def calibration(self) -> Calibration | None:
        """The camera over the floor; None while too little was seen."""
        if self._calibration is None and len(self._seen) >= 3:
            self._calibration = self._fitted()
            new = self._calibration.misfit[-_MOVED_AFTER:]
            if len(self._seen) > _MOVED_AFTER and np.median(new) > _MOVED_FROM:
                self._seen = self._seen[-_MOVED_AFTER:]
                self._calibration = self._fitted()
        return self._calibration

    def _fitted(self) -> Calibration:
        assert self._camera is not None
        who, rows = zip(*self._seen, strict=True)
        return fitted(np.array(rows), np.array(who), focal_is_known=self._camera.given)

    def height(self, who: int, landmarks: Landmarks) -> Height | None:
        """How high a body is over the floor; None while the floor is not known."""
        known, camera = self.calibration, self._camera
        if known is None or camera is None:
            return None
        # The camera, and the size of this person.
        columns = [0, 1, 2, 3]
        state, covariance = np.zeros(5), np.diag([0.0, 0.0, 0.0, 0.0, _SIZE_SD**2])
        if who in known.people:
            columns.append(4 + known.people.index(who))
        count = len(columns)
        state[:count] = known.mean[columns]
        covariance[:count, :count] = known.covariance[np.ix_(columns, columns)]

        rays = camera.rays(landmarks.positions)

        def over_floor(state: NDArray[np.float64]) -> float:
            wide = np.concatenate([rays[:, :2] / np.exp(state[3]), rays[:, 2:]], axis=1)
            below = np.exp(state[4]) * (
                _placed(landmarks, wide)[_PARTS].mean(axis=1) @ _down(state)
            )
            # Of the five parts, the lowest show what a body lies on: people also raise their heads
            # and knees.
            return float(np.exp(state[2]) - np.sort(below)[-3:].mean())

        mean, step = over_floor(state), 1e-4
        slopes = np.array([(over_floor(state + one) - mean) / step for one in step * np.eye(5)])
        # Standard deviation of the logarithm of a body's distance, as of rendered ones that lie.
        of_body = 0.07 * (np.exp(state[2]) - mean)
        return Height(mean, math.sqrt(of_body**2 + max(0.0, slopes @ covariance @ slopes)))


def _stands(person: Person, frame_shape: tuple[int, ...]) -> bool:
    posture, trust, landmarks = person.frame_posture, person.trust, person.landmarks
    if posture is None or trust is None or landmarks is None:
        return False
    ends = [*_EARS, *_ANKLES]
    places, corner = landmarks.positions[ends], np.array(frame_shape[1::-1]) - 1
    return bool(
        posture.of("standing") >= 0.8
        and trust.right >= 0.3
        and landmarks.visibility[ends].min() >= 0.5
        and ((places > 0) & (places < corner)).all()
    )


def _placed(landmarks: Landmarks, rays: NDArray[np.float64]) -> NDArray[np.float64]:
    """Landmarks ``(33, 3)`` in camera axes, metres, where they have their size in the picture."""
    axes = to_line_of_sight(rays[_HIPS].mean(axis=0))
    weights = np.maximum(landmarks.visibility, 0.05)
    return place_on_sight_lines(landmarks.metres, rays, axes, weights).points


def _down(state: NDArray[np.float64]) -> NDArray[np.float64]:
    """The direction ``(3,)`` of gravity in camera axes."""
    tilt, roll = state[:2]
    return np.array([np.sin(roll) * np.cos(tilt), np.cos(roll) * np.cos(tilt), np.sin(tilt)])


def _residuals(
    state: NDArray[np.float64], rows: NDArray[np.float64], sizes: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Residuals ``(N, 4)`` of sightings ``(N, 8)`` of people of log sizes ``(N,)``."""
    down, height, wider = _down(state), np.exp(state[2]), np.exp(state[3])
    size, ones = np.exp(sizes)[:, None], np.ones((len(rows), 1))
    rays = np.hstack([rows[:, :2] / wider, ones])
    feet = rays * (height / np.maximum(rays @ down, 0.005 * height))[:, None]
    head, hips = feet - _EARS_M * size * down, feet - _HIPS_M * size * down
    expected = wider * head[:, :2] / np.maximum(head[:, 2:], 0.1)
    away = (rows[:, 2:4] - expected) / (wider * _EARS_M * size / feet[:, 2:])
    scale = np.log(np.maximum(rows[:, 6], 1e-4) * np.maximum(hips[:, 2], 0.1) / wider) - sizes
    sight = np.hstack([rows[:, 4:6] / wider, ones])
    climb = (sight @ down) / np.linalg.norm(sight, axis=1)
    elevation = np.arcsin(np.clip(climb, -1, 1)) - rows[:, 7]
    return np.column_stack([away, scale, elevation]) / _NOISE


def _robust(residuals: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
    """Cauchy's cost of residuals, and the weight of each."""
    squares = (residuals / _WRONG_FROM) ** 2
    return float(_WRONG_FROM**2 * np.log1p(squares).sum()), 1 / (1 + squares)


def fitted(
    rows: NDArray[np.float64], who: NDArray[np.int64], *, focal_is_known: bool
) -> Calibration:
    """The likeliest camera of sightings ``(N, 8)``, by Levenberg's and Marquardt's method.

    A row has the places of feet, head and hips over the focal length, the inverse distance of the
    hips by the size of the body, and the camera's elevation.
    """
    people, index = np.unique(who, return_inverse=True)
    count = len(people)
    usual, sd = np.zeros(4 + count), np.full(4 + count, _SIZE_SD)
    usual[:4], sd[:4] = _USUAL, _USUAL_SD
    if focal_is_known:
        usual[3], sd[3] = 0.0, 0.03
    elevation, distance = float(np.median(rows[:, 7])), 1 / float(np.median(rows[:, 6]))
    state = usual.copy()
    state[0] = elevation - np.arctan(np.median(rows[:, 5]))
    state[2] = np.log(np.clip(distance * np.sin(elevation) + _HIPS_M, 0.6, 8))

    def at(state: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
        residuals, unusual = _residuals(state, rows, state[4:][index]), (state - usual) / sd
        return residuals, unusual, _INDEPENDENT * _robust(residuals)[0] + _robust(unusual)[0]

    residuals, unusual, least = at(state)
    damping, delta, owns = 1e-2, 1e-4, np.eye(count)[index]
    for _ in range(20):
        slopes = np.empty((*residuals.shape, 4 + count))
        for column in range(4):
            moved = state + delta * (np.arange(4 + count) == column)
            slopes[..., column] = (at(moved)[0] - residuals) / delta
        moved = state + delta * (np.arange(4 + count) >= 4)
        slopes[..., 4:] = ((at(moved)[0] - residuals) / delta)[..., None] * owns[:, None]
        jacobian, flat = slopes.reshape(-1, 4 + count), residuals.ravel()
        weights, prior = _INDEPENDENT * _robust(flat)[1], _robust(unusual)[1]
        curvature = jacobian.T @ (weights[:, None] * jacobian) + np.diag(prior / sd**2)
        slope = jacobian.T @ (weights * flat) + prior * unusual / sd
        step = np.linalg.solve(curvature + damping * np.diag(np.diag(curvature)), -slope)
        tried = at(state + np.clip(step, -0.5, 0.5))
        if tried[2] >= least:
            damping *= 8
            continue
        state, gained = state + np.clip(step, -0.5, 0.5), least - tried[2]
        residuals, unusual, least = tried
        damping = max(damping / 5, 1e-4)
        if gained < 1e-3:
            break
    misfit = np.sqrt((residuals[:, :3] ** 2).mean(axis=1))
    covariance = np.asarray(np.linalg.inv(curvature), np.float64)
    return Calibration(state, covariance, tuple(people.tolist()), misfit)
