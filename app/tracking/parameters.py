"""The numbers of tracking that were set by hand, by topic; :data:`DEFAULTS` holds those in use.

Experiments vary them from here. Numbers that define a format stand beside their code, and the
fitted weights of actions in ``models/actions.json``. Units are in the names: ``_s`` seconds,
``_m`` metres, ``_px`` pixels, ``_deg`` degrees, ``_hz`` frames a second.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from app.vision.blazepose import LANDMARK_PX


@dataclass(frozen=True)
class SessionParameters:
    """When a session starts afresh, and when it drops a track."""

    min_step_s: float = 1e-3  # Frames closer together have no order that a camera could have seen.
    max_gap_s: float = 10.0  # After a longer gap the scene may be another one.
    # A frame that is late by more than this was not overtaken by another one: the clock was set, or
    # an earlier timestamp was wrong.
    max_late_s: float = 5.0
    # Seconds without a sighting after which a track is dropped: usually, and for a person who is
    # hidden behind another one or vanished away from the frame's border.
    dropped_after_s: float = 0.5
    predicted_for_s: float = 2.0
    hidden_share: float = 0.5  # Share of a person's box that another must cover to hide them.


@dataclass(frozen=True)
class DetectionParameters:
    """How the people of a frame are found."""

    search_every_s: float = 0.4  # Time between two searches of the whole frame.
    window_lasts_s: float = 0.5  # A track's window is read for this long after a sighting.
    # A window has lost its person if the landmark network's presence is below the first number, or
    # if the next window would be farther away than the second, as a share of the window's side.
    min_presence: float = 0.5
    max_drift: float = 0.35
    # Size of a body from which MoveNet also reads keypoints in a track's window. That takes as long
    # as the reading itself; poses of smaller people are averaged over more frames instead.
    movenet_from_px: float = 200.0
    body_margin: float = 0.1  # Margin around a body's landmarks, as a share of their box.
    min_track_iou: float = 0.3  # Overlap of a detection with the predicted box of its track.


@dataclass(frozen=True)
class BoxParameters:
    """The filter that predicts a person's box."""

    # Share of the difference between prediction and observation by which each is corrected.
    place_gain: float = 0.7
    velocity_gain: float = 0.3
    size_gain: float = 0.3
    drift_s: float = 1.0  # Time in which an unseen person's velocity falls to 1/e.
    min_step_s: float = 1e-3  # Least elapsed time: a frame that is sent again has the same time.


@dataclass(frozen=True)
class MatchingParameters:
    """How sightings are matched to tracks; distances are in sizes of the person."""

    # Largest distance of a person from the predicted place: at once, its growth for each second
    # since the last sighting, and its limit.
    near: float = 0.3
    near_per_s: float = 1.0
    far: float = 2.0
    # Largest ratio of two sizes of one person at once; it applies once more for each second since
    # the last sighting. A person's box shrinks within half a second in a fall towards the camera.
    max_growth: float = 1.6
    # Weights of the costs of a pair, each 0 to 1 within the limits above.
    place_weight: float = 0.4
    overlap_weight: float = 0.3
    size_weight: float = 0.2
    appearance_weight: float = 0.6
    unknown_appearance: float = 0.3  # Cost of the appearance if either one is unknown.
    # Factor of the cost for the track in whose window the person was read.
    window_factor: float = 0.5
    max_cost: float = 1.1  # At a higher cost a sighting begins a new track.


@dataclass(frozen=True)
class TrackParameters:
    """When a track counts as a person."""

    # With landmarks: the probability of a person from which a track counts as one, and the share of
    # people among the windows that the model of this probability was trained on.
    min_probability: float = 0.9
    people_share: float = 6 / 7
    # Time over which windows are averaged: a person may take a seat that was followed while empty.
    window_mean_s: float = 3.0
    # Without landmarks: the detector's score that is enough at once, and the number of sightings
    # that is always enough.
    confirming_score: float = 0.6
    confirming_sightings: int = 3
    # Exponent of the probability that landmarks are right, in the weight of a frame's posture.
    # On held-out renders postures are right in 39, 58, 69, 77, 82 and 89 % where that probability
    # is 0.005, 0.03, 0.1, 0.3, 0.55 and 0.85.
    reliability_exponent: float = 0.25
    appearance_gain: float = 0.1  # Share of the difference that corrects the known appearance.


@dataclass(frozen=True)
class GroundParameters:
    """How motion over the ground is measured; see :mod:`app.tracking.motion`."""

    window_s: float = 1.0  # Time over which a velocity is measured.
    min_frames: int = 3  # Fewest frames for a velocity.
    # Least elevation for a velocity, whose direction matters, and its least sine for the path from
    # which actions are recognised, in which noise must not look like steps.
    min_elevation_deg: float = 6.0
    min_path_sine: float = 0.35
    # Elevation from which steps away from the camera count in full for the speed: seen by a lower
    # camera, they hardly change the height in the picture.
    reliable_elevation_deg: float = 20.0


@dataclass(frozen=True)
class HeadingParameters:
    """The filter of headings.

    The values were chosen on UP-Fall's first activities at 0.35 of their size, against their full
    size, and on Pose2Sim's cameras at a tenth of it. Every ``_deg`` except the last is a standard
    deviation.
    """

    turn_deg: float = 80.0  # Turn of a person within a second.
    # Rate of jumps to any other heading: detection and identity may be wrong.
    jumps_per_s: float = 0.05
    seen_deg: float = 20.0  # Error of a right hypothesis's azimuth, for small people.
    clearly_seen_deg: float = 15.0  # The same error for large people.
    outlier_share: float = 0.2  # Share of frames in which no hypothesis faces the right way.
    walking_deg: float = 40.0  # Angle between the directions in which people walk and face.
    backward_share: float = 0.1  # Share of people who walk in any other direction.
    # Weight of the walking direction, which is measured over a second.
    direction_weight: float = 0.3
    min_walking_m_s: float = 0.5  # Speed from which the walking direction is used.
    full_walking_m_s: float = 1.0  # Speed from which it has its full weight.
    # Probability of the other side from which front and back are exchanged: people seen from the
    # side keep one of them.
    switch_from: float = 0.8
    min_turned_deg: float = 2.0  # Least turn of the shoulders from the exact side view.
    independent_hz: float = 6.0  # Frame rate above which each frame counts less.


@dataclass(frozen=True)
class SmoothingParameters:
    """The hidden Markov model of poses."""

    max_states: int = 12  # Hypotheses of a frame that become states; 30 are no better.
    reference_hz: float = 10.0  # Frame rate for which the weights and costs below are given.
    confidence_weight: float = 1.5  # Weight of the log of a hypothesis's confidence.
    # Weight of the log of the distance by silhouette and landmarks, if landmarks were read: the
    # confidences of all hypotheses that agree with them are near 1.
    landmark_weight: float = 40.0
    # Height from which landmarks have their full weight: the side of the network's window. Those of
    # smaller people jitter, so motion counts more.
    full_weight_px: float = LANDMARK_PX
    # Cost in nats of each metre that joints move on average from frame to frame; up to twice as
    # much at higher rates, less at lower ones.
    cost_per_m: float = 60.0
    # Largest cost of a move: none is impossible, since detection and identity may be wrong.
    max_cost: float = 48.0
    heading_weight: float = 1.0  # Weight of the log of the heading's probability.
    nearby_m: float = 0.25  # Poses at this distance from the most probable one weigh 60 % of it.
    sharpness: float = 0.5  # Exponent of probabilities: frames are not independent.
    # Time over which a line is fitted to the averages: for silhouettes alone, and for landmarks of
    # full weight, which follow quick limbs; and the largest number of frames in it.
    line_s: float = 0.35
    landmark_line_s: float = 0.12
    max_line_frames: int = 24
    extrapolated_s: float = 1.0  # A pose is kept this long without a silhouette.
    # Log odds that a kept pose loses in a second; measured on the clips that the confidence was
    # fitted on.
    lost_per_s: float = 5.0
    # Log odds of a smooth pose: an offset, and weights of the log odds of the hypotheses near it
    # and of the share of probability near it; `python -m scripts evaluate tracking --fit-tracks`.
    confidence_offset: float = -0.46
    hypotheses_weight: float = 1.39
    agreement_weight: float = 0.39


@dataclass(frozen=True)
class PostureParameters:
    """The average of postures over time."""

    settling_s: float = 0.4  # Time constant with which the posture follows the frames.
    # Longest gap that counts: after a longer one, the newest frame has no more weight.
    max_step_s: float = 1.0
    wide_from: float = 1.2  # Width over height of a box from which its person is likely lying.
    wide_slope: float = 3.0  # Exponent of that ratio in the odds.


@dataclass(frozen=True)
class EventParameters:
    """When events begin and end."""

    settling_s: float = 0.5  # Time constant of the low-pass filter over the frames.
    begins_from: float = 0.5  # Filtered probability at which something begins.
    ends_below: float = 0.2  # Filtered probability below which it ends.
    max_step_s: float = 0.34  # Most time for a single frame: just too short to begin an event.
    # A fall from standing, from a chair or out of bed takes the hips down by this many metres
    # within so many seconds. Bending hardly moves them; people who go to bed lower them by 0.2 m.
    min_drop_m: float = 0.4
    drop_within_s: float = 1.5
    # Share of the drop by which the hips stay down: after a jump, they come up again.
    kept_drop: float = 0.6
    # Filtered probability of being on the ground that a fall needs after such a drop, its reduction
    # for every further metre, and its minimum: hips lower than a seat can only be on the ground.
    min_on_ground: float = 0.5
    on_ground_per_m: float = 1.0
    min_on_ground_after_deep_drop: float = 0.3
    down_within_s: float = 2.5  # Longest time from the drop to that probability.
    stays_down_s: float = 0.5  # Time on the ground after the drop before a fall is reported.
    # Elevation of a camera up to which a drop is corrected for looking shorter from above.
    max_elevation_deg: float = 60.0


@dataclass(frozen=True)
class ZoneParameters:
    """When a person has entered or left a zone."""

    # Distance outside, in sizes of the person, up to which a person who has entered stays in the
    # zone: feet at a border move by some hundredths of a body from frame to frame.
    margin: float = 0.1
    settling_s: float = 0.5  # Time inside or outside before an event is reported.


@dataclass(frozen=True)
class ActionParameters:
    """The sliding window of actions, and what is used beside the linear model."""

    window_s: float = 3.0  # Motion from which an action is recognised.
    min_window_s: float = 1.0  # The shortest motion that suffices.
    every_s: float = 0.5  # Time between two results: what people do changes slowly.
    min_step_s: float = 1 / 40  # Poses closer together only add memory: motion is sampled at 10 Hz.
    max_gap_s: float = 1.0  # After a longer gap without a pose the window starts afresh.
    min_vote: float = 0.02  # Share of the votes for an action that no hypothesis shows.
    min_posture: float = 0.1  # Factor of an action that the posture of the moment contradicts.
    # Log odds of everyday actions against exercises if the motion of limbs is not seen.
    everyday_log_odds: float = math.log(10)
    full_weight_px: float = LANDMARK_PX  # Height from which limbs' motion counts in full.


@dataclass(frozen=True)
class SummaryParameters:
    """The summary of a video."""

    max_gap_s: float = 2.0  # A person unseen for longer is not assumed to keep a posture.


@dataclass(frozen=True)
class TrackingParameters:
    """All parameters of tracking."""

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
    zones: ZoneParameters = ZoneParameters()
    actions: ActionParameters = ActionParameters()
    summary: SummaryParameters = SummaryParameters()


DEFAULTS = TrackingParameters()
