"""Hand-set numbers of the estimation, each with its unit and its reason.

Fitted ones are in ``app/vision/models/fitted.json``; those of matching in :mod:`index.parameters`.
"""

from __future__ import annotations

from dataclasses import dataclass

from index.parameters import DEFAULT_HYPOTHESES


@dataclass(frozen=True)
class MaskParameters:
    """When a mask with one label shows several people; see :mod:`app.estimation.upload`."""

    # Parts from this share of the largest part's area are compared
    min_figure_share: float = 0.25
    # Height of the smallest part that may be a person
    min_figure_px: int = 48
    # Two parts are different people if the gap between them is wider than this share of the
    # narrower one
    min_gap_share: float = 0.5


@dataclass(frozen=True)
class NormalisationParameters:
    """Which landmarks are used for matching; see :mod:`app.estimation.normalise`."""

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
    """How votes and landmarks decide; see :mod:`app.estimation.posture_probability`."""

    # Hypotheses that vote, however many were requested
    voters: int = DEFAULT_HYPOTHESES
    # Probability from which a posture is reported; below, it is ``unclear``
    min_probability: float = 0.5
    # A group of postures with a smaller share of the votes is filled up with stand-ins
    min_group_share: float = 0.02
    # Bend of the straighter knee at which legs are as likely standing as not. A thigh that points
    # at the camera looks like a standing one; of a walking person, one knee is straight.
    bent_from_deg: float = 45.0
    # Change of that bend which changes the log odds by one
    bent_slope_deg: float = 5.0
    # Visibility of hips, knees and ankles below which the bend is not judged
    min_leg_visibility: float = 0.5
    # Cosine of the angles of trunk and shanks with the vertical from which two bent knees are more
    # likely sitting than crouching or kneeling
    min_seat_cosine: float = 0.85
    # How often they are sitting then: in 78 % of simulated bodies
    seated_share: float = 0.8


MASKS = MaskParameters()
NORMALISATION = NormalisationParameters()
POSTURE = PostureParameters()

DUPLICATE_BODY_DISTANCE = 0.12
"""Mean distance between landmarks, in sizes of the body, below which two readings show the same
person."""

HYPOTHESES_PER_OPPOSITE_FACING = 7
"""One in this many hypotheses faces the opposite way to the first: keypoints may mislead."""

THREADS_PER_PASS = 2
"""Threads that share a pass of a network with little loss; more do not."""
