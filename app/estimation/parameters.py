"""Hand-set numbers of the estimation, each with its unit and its reason.

Fitted ones are in ``app/vision/models/fitted.json``.
"""

from __future__ import annotations

from dataclasses import dataclass

from index.matching import DEFAULT_HYPOTHESES


@dataclass(frozen=True)
class MaskParameters:
    """When a mask with one label shows several people; see :mod:`app.estimation.upload`."""

    # Smallest parts that are compared, as a share of the largest part's area
    min_figure_share: float = 0.25
    # Height of the smallest part that may be a person
    min_figure_px: int = 48
    # Two parts are different people if the gap between them is wider than this share of the
    # narrower one
    min_gap_share: float = 0.5


@dataclass(frozen=True)
class NormalisationParameters:
    """Which landmarks are used for matching; see :mod:`app.estimation.poses`."""

    # Visibility above which a landmark is used
    min_score: float = 0.05
    # With fewer landmarks a person is matched by the silhouette alone
    min_keypoints: int = 4
    # Visibility of the more visible ankle of a person seen whole
    min_feet_visibility: float = 0.35
    # Visibility of the most visible point of the head of a person seen whole
    min_head_visibility: float = 0.2


@dataclass(frozen=True)
class PostureParameters:
    """How votes and landmarks decide; see :mod:`app.estimation.posture`."""

    # Hypotheses that vote, however many were requested
    voters: int = DEFAULT_HYPOTHESES
    # Probability from which a posture is reported; below, it is ``unclear``
    min_probability: float = 0.5
    # Probability above the minimum that a posture can reach, per confidence of the best
    # hypothesis: above 0.8 from a confidence of 0.2
    confidence_slope: float = 1.5


@dataclass(frozen=True)
class PlacementParameters:
    """How skeletons are placed in front of the camera; see :mod:`app.estimation.poses`."""

    # Visibility below which a landmark does not move a joint
    min_visibility: float = 0.05
    # Standard deviation of a landmark's depth, metres, at which the first hypothesis moves half way
    # to it: the hypothesis has been fitted to the landmarks, so it adds little information
    half_way_sd_m: float = 0.3
    # Limits of the person's size relative to a hypothesis
    sizes: tuple[float, float] = (0.8, 1.25)
    # Least forward component of a joint's line of sight, and least distance in metres
    min_forward: float = 0.05
    min_distance_m: float = 0.1
    # Standard deviation of the logarithm of a body's size, and so of its distance
    size_sd: float = 0.1


MASKS = MaskParameters()
PLACEMENT = PlacementParameters()
NORMALISATION = NormalisationParameters()
POSTURE = PostureParameters()

MAX_FRAMES_OF_PEOPLE = 4
"""A caller's boxes may together cover this many times the area of the largest frame. The boxes of a
crowd overlap less, and the work on people grows with their pixels."""

MIN_BOX_PX = 0.01
"""Shortest side of a caller's box: a unit of the last digit of a reply."""

DUPLICATE_BODY_DISTANCE = 0.12
"""Mean distance between landmarks, in sizes of the body, below which two readings show the same
person."""

HYPOTHESES_PER_OPPOSITE_FACING = 7
"""At least one in this many hypotheses faces the opposite way to the first, since keypoints may be
wrong."""

THREADS_PER_PASS = 2
"""Threads that share a pass of a network with little loss; more do not."""
