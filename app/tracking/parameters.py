"""The numbers of tracking that were set by hand, by topic; :data:`DEFAULTS` holds those in use.

Experiments vary them from here. Numbers that define a format stand beside their code, and the
fitted weights of actions in ``models/actions.json``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from app.vision.blazepose import LANDMARK_PX


@dataclass(frozen=True)
class SessionParameters:
    """When a session starts afresh, and when it drops a track."""

    min_step_s: float = 1e-3
    """Frames closer together have no order that a camera could have seen."""
    max_gap_s: float = 10.0
    """After a longer gap the session starts afresh: the scene may be another one."""
    dropped_after_s: float = 0.5
    """Seconds without a sighting after which a track is dropped ..."""
    predicted_for_s: float = 2.0
    """... and the same where the person is hidden behind another one or vanished away from the
    border of the frame."""
    hidden_share: float = 0.5
    """Share of a person's box that another box has to cover to hide them."""


@dataclass(frozen=True)
class DetectionParameters:
    """How the people of a frame are found."""

    search_every_s: float = 0.4
    """Seconds between two searches of the whole frame."""
    window_lasts_s: float = 0.5
    """Seconds after a reading for which its window still shows where the person is."""
    max_drift: float = 0.35
    """Distance from a window to the next one, in windows, beyond which it has lost the body."""
    movenet_from_px: float = 200.0
    """Size of a body from which MoveNet places joints in a track's window too. That takes as long
    as the reading itself; poses of smaller people are averaged over more frames instead."""
    body_margin: float = 0.1
    """Margin around the landmarks in which a body is cut out, as a share of their box."""
    min_track_iou: float = 0.3
    """Overlap of a detection with a track's predicted box from which it is the track's person."""


@dataclass(frozen=True)
class BoxParameters:
    """The filter of a person's box."""

    place_gain: float = 0.7
    """Share of the difference between predicted and observed place that corrects the place ..."""
    velocity_gain: float = 0.3
    """... and the velocity ..."""
    size_gain: float = 0.3
    """... and the same of the size."""
    drift_s: float = 1.0
    """Seconds in which the velocity of an unseen person falls to 1/e."""
    min_step_s: float = 1e-3
    """A frame that is sent again has the same time."""


@dataclass(frozen=True)
class MatchingParameters:
    """How sightings are matched to tracks; distances in sizes of the person."""

    near: float = 0.3
    """Distance from the predicted place at which a person may be seen at once ..."""
    near_per_s: float = 1.0
    """... plus this for each second since the last sighting ..."""
    far: float = 2.0
    """... and at most."""
    max_growth: float = 1.6
    """Largest ratio of two sizes of one person at once, and once more for each second since the
    last sighting: a person who falls towards the camera shrinks within half a second."""
    place_weight: float = 0.4
    """Weights of the costs of a pair, each cost 0 to 1 within the limits above."""
    overlap_weight: float = 0.3
    size_weight: float = 0.2
    appearance_weight: float = 0.6
    unknown_appearance: float = 0.3
    """Cost of the appearance where either is unknown."""
    window_factor: float = 0.5
    """Share of the cost that counts for the track in whose window the person was read."""
    max_cost: float = 1.1
    """Cost from which a sighting rather begins a new track."""


@dataclass(frozen=True)
class TrackParameters:
    """When a track counts as a person."""

    confirming_score: float = 0.6
    """Probability by the detector that confirms a track at once ..."""
    confirming_sightings: int = 3
    """... and number of sightings that confirm any other."""
    min_presence: float = 0.5
    """Presence from which the landmark network sees a person. It must have done so once for a
    detection to count: on tables and tripods it often stays near 0, and it falls below 0.1 where a
    person has left."""
    appearance_gain: float = 0.1
    """Share of the difference by which a sighting corrects the known appearance."""


@dataclass(frozen=True)
class GroundParameters:
    """How motion over the ground is measured."""

    window_s: float = 1.0
    """Seconds over which a velocity is measured ..."""
    min_frames: int = 3
    """... in at least as many frames."""
    min_elevation_deg: float = 6.0
    """Elevations are taken to be no smaller for a velocity, whose direction counts."""
    reliable_elevation_deg: float = 20.0
    """Elevation from which steps away from the camera count in full for the speed: seen from
    lower, they hardly change the height in the picture, and most of them is noise."""
    min_path_sine: float = 0.35
    """Sines of elevations are taken to be no smaller for the paths from which actions are
    recognised, where noise must not look like steps."""


@dataclass(frozen=True)
class HeadingParameters:
    """The filter of headings.

    They were chosen on UP-Fall's first activities at 0.35 of their size, against their full size,
    and on Pose2Sim's cameras at a tenth of it.
    """

    turn_deg: float = 80.0
    """Standard deviation of a turn within a second."""
    jumps_per_s: float = 0.05
    """Rate at which the heading becomes any other: detection and identity may be wrong."""
    seen_deg: float = 20.0
    """Standard deviation of the azimuth of a right hypothesis, of small people ..."""
    clearly_seen_deg: float = 15.0
    """... and of large ones."""
    outlier_share: float = 0.2
    """Share of frames in which no hypothesis faces the right way."""
    walking_deg: float = 40.0
    """Standard deviation of the direction in which people walk from the one they face ..."""
    backward_share: float = 0.1
    """... and share of them who walk in any other direction."""
    walking_weight: float = 0.3
    """Weight of the walking direction beside a frame: one is measured over a second."""
    min_walking_m_s: float = 0.5
    """Speed from which the walking direction counts ..."""
    full_walking_m_s: float = 1.0
    """... and from which it counts in full."""
    switch_from: float = 0.8
    """Probability from which front and back are exchanged: a person seen from the side keeps one
    of them."""
    min_turned_deg: float = 2.0
    """Shoulders are turned from the exact side view at least as far."""
    independent_hz: float = 6.0
    """Rate up to which frames are independent evidence; at higher rates each counts less."""


@dataclass(frozen=True)
class SmoothingParameters:
    """The hidden Markov model of poses."""

    max_states: int = 12
    """Hypotheses of a frame that become states; 30 are no better."""
    reference_hz: float = 10.0
    """Frames a second that the weights and costs below are given for."""
    confidence_weight: float = 1.5
    """Weight of the log of a hypothesis's confidence; at higher rates each frame counts less."""
    landmark_weight: float = 40.0
    """Weight of the log of the distance by silhouette and landmarks, where landmarks were read:
    the confidences of all hypotheses that agree with them are near 1."""
    full_weight_px: float = LANDMARK_PX
    """Height of a person from which landmarks weigh in full, the side of the network's window.
    Those of smaller people jitter, and motion counts more."""
    cost_per_m: float = 60.0
    """Nats for each metre that joints move on average between two frames; up to twice as many
    between frames that follow faster, fewer between slower ones."""
    max_cost: float = 48.0
    """No move is impossible: detection and identity may be wrong."""
    heading_weight: float = 1.0
    """Weight of the log of the heading's probability."""
    nearby_m: float = 0.25
    """A pose whose joints are at this mean distance from the most probable one weighs 60 % of
    it."""
    sharpness: float = 0.5
    """Exponent of the states' probabilities in the average: frames are no independent evidence."""
    line_s: float = 0.35
    """Seconds through whose averages a line is fitted, for silhouettes alone ..."""
    landmark_line_s: float = 0.12
    """... and where landmarks weigh in full, which follow quick limbs."""
    max_line_frames: int = 24
    """Frames through whose averages a line is fitted at most."""
    extrapolated_s: float = 1.0
    """Seconds for which a pose is kept while the person is seen without a silhouette."""
    lost_per_s: float = 5.0
    """Log odds of its confidence that a kept pose loses in a second; measured on the clips that the
    confidence was fitted on."""
    confidence_offset: float = -0.46
    """Log odds of a smooth pose: an offset and the two weights below, fitted by
    ``python -m scripts.evaluate tracking --fit-tracks``."""
    hypotheses_weight: float = 1.39
    """Weight of the log odds of the hypotheses near the pose ..."""
    agreement_weight: float = 0.39
    """... and of the share of probability near it."""


@dataclass(frozen=True)
class PostureParameters:
    """The average of postures over time."""

    settling_s: float = 0.4
    """Time constant with which the posture follows the frames."""
    max_step_s: float = 1.0
    """After a longer gap the newest frame counts no more than after this one."""
    wide_from: float = 1.2
    """Width over height of a box from which the person in it is more likely lying ..."""
    wide_slope: float = 3.0
    """... and exponent of that ratio in the odds."""


@dataclass(frozen=True)
class EventParameters:
    """When events begin and end."""

    settling_s: float = 0.5
    """Time constant of the low-pass filter over the frames' probabilities."""
    begins_from: float = 0.5
    """Filtered probability at which something begins ..."""
    ends_below: float = 0.2
    """... and below which it ends."""
    max_step_s: float = 0.34
    """Seconds that a frame stands for at most: a single one takes the filter just short of where
    something begins."""
    falls_within_s: float = 4.0
    """Longest time from the last upright moment to the ground; a slower descent is lying down."""
    stays_down_s: float = 1.5
    """Seconds on the ground after which a fall is reported."""
    dropped_to: float = 0.55
    """Share of a person's upright height in the picture below which they are down, whatever the
    posture: a person who sits on a chair or kneels keeps two thirds."""


@dataclass(frozen=True)
class ActionParameters:
    """The sliding window of actions, and what counts beside the linear model."""

    window_s: float = 3.0
    """Seconds of motion from which an action is recognised ..."""
    min_window_s: float = 1.0
    """... and how many there must be at least."""
    every_s: float = 0.5
    """Seconds between two results: what people do changes slowly."""
    min_step_s: float = 1 / 40
    """Poses closer together add nothing but memory to a motion that is sampled at 10 Hz."""
    max_gap_s: float = 1.0
    """After a longer gap without a pose the window starts afresh."""
    min_vote: float = 0.02
    """Share of the votes of an action that no hypothesis shows."""
    min_posture: float = 0.1
    """Factor that is left of an action's probability where the posture contradicts it: it may be
    that of a moment."""
    everyday_log_odds: float = math.log(10)
    """Log odds of everyday actions against exercises, where the motion of limbs is not seen."""
    full_weight_px: float = LANDMARK_PX
    """Height of a person from which the motion of limbs counts in full, as in smoothing."""


@dataclass(frozen=True)
class SummaryParameters:
    """The summary of a video."""

    max_gap_s: float = 2.0
    """Seconds without a sighting for which a person is taken to keep a posture."""


@dataclass(frozen=True)
class TrackingParameters:
    """All of them."""

    session: SessionParameters = SessionParameters()
    detection: DetectionParameters = DetectionParameters()
    box: BoxParameters = BoxParameters()
    matching: MatchingParameters = MatchingParameters()
    track: TrackParameters = TrackParameters()
    ground: GroundParameters = GroundParameters()
    heading: HeadingParameters = HeadingParameters()
    smoothing: SmoothingParameters = SmoothingParameters()
    posture: PostureParameters = PostureParameters()
    events: EventParameters = EventParameters()
    actions: ActionParameters = ActionParameters()
    summary: SummaryParameters = SummaryParameters()


DEFAULTS = TrackingParameters()
