"""Hand-set numbers of matching, each with its unit and its reason.

Fitted numbers lie beside the index; those that a format or a network's architecture fixes, beside
its code.
"""

from __future__ import annotations

from dataclasses import dataclass

DEFAULT_HYPOTHESES = 7
"""Hypotheses returned unless a caller asks for another number; the confidence is fitted for them,
and this many decide posture and facing however many are requested."""


@dataclass(frozen=True)
class MatchParameters:
    """How many candidates and modes are considered; see :mod:`index.matching`."""

    # Number of nearest entries without keypoints; more add few useful modes
    candidates: int = 160
    # The same number if a network ranks the modes, which can use a few more
    ranked_candidates: int = 200
    # With keypoints: number of entries nearest to each rotation of the silhouette
    silhouette_candidates: int = 150
    # With keypoints: number of entries nearest to the landmarks
    landmark_candidates: int = 50
    # With keypoints: number of best candidates of both kinds, from which the modes are made
    kept_candidates: int = 200
    # Fewest candidates of one kind for each hypothesis requested
    candidates_per_hypothesis: int = 20
    # Factor by which the candidates may grow if they hold too few distinct poses
    max_candidate_growth: int = 16
    # Modes computed beyond those requested: a sparse mode may fit best
    spare_modes: int = 4
    # Hypotheses are found in batches of this size, twice it, and so on, so that the first k of n
    # are those found when k are requested
    first_batch: int = DEFAULT_HYPOTHESES
    # If a batch of this many times the number requested adds nothing, it is the last: few distinct
    # poses may fit a person who is hardly seen, and looking for 50 took seconds
    max_batch_growth: int = 4
    # Mean joint distance from all earlier hypotheses that makes one of a later batch new
    min_new_pose_m: float = 0.055
    # A person tilted by more than this in the picture is lying rather than standing
    max_standing_tilt_deg: float = 30.0
    # Landmarks whose trunk is tilted by less are searched only as they are
    max_upright_trunk_deg: float = 12.0
    # Smallest scale at which candidates are placed by keypoints
    min_px_per_metre: float = 5.0


@dataclass(frozen=True)
class ModeParameters:
    """The density of candidates and its modes; see :mod:`index.modes`."""

    # Smallest root mean square joint distance between the centres of two modes; half of it is
    # enough after interpolation
    distinct_m: float = 0.11
    # Bandwidth of the density's Gaussian kernel, a root mean square joint distance. Smaller for an
    # index that covers few motions densely, as in the paper's experiments.
    bandwidth_m: float = 0.08
    # Bandwidth of the kernel that removes a mode once taken, as a multiple of ``bandwidth_m``
    suppression: float = 1.5
    # Fall-off of the candidates' weights with distance; see :func:`index.modes.candidate_weights`
    fall_off: float = 0.3
    # The same with keypoints, which distinguish near candidates better than descriptors do
    fall_off_with_keypoints: float = 0.6
    # Smallest distance of the nearest candidate, as a share of the farthest's, for the fall-off:
    # otherwise an entry that equals the query would outweigh all others
    min_nearest_share: float = 0.02
    # Exponent of the keypoints' likelihood in the weights: their errors are correlated (left for
    # right)
    likelihood_exponent: float = 0.5
    # Descriptor distance equivalent to a pixel between a point and its keypoint
    residual_weight: float = 0.5
    # Ridge of the regression, relative to the variance of a mode's descriptors
    ridge: float = 0.45
    # Candidates below this share of the largest weight in a mode do not belong to it
    min_member_weight: float = 1e-3
    # Decimals to which densities are rounded, so that rounding errors do not break ties
    density_digits: int = 12


@dataclass(frozen=True)
class KeypointParameters:
    """How landmarks are compared with skeletons and fitted; see :mod:`index.landmarks`."""

    # Standard deviation of a point about its keypoint, pixels of the normalised frame
    sigma_px: float = 8.0
    # Standard deviation of a point about its landmark in three dimensions, metres
    sigma_m: float = 0.15
    # Weight of the landmarks in three dimensions beside their places in the picture, which are more
    # certain
    limb_weight: float = 0.25
    # Weight of outliers among keypoints, so that no single keypoint rules a pose out
    outlier_weight: float = 0.05
    # Likelihoods below this are set to zero, since arithmetic on denormal numbers is slow
    min_mass: float = 1e-6
    # Factors by which a body may differ in size from its landmarks
    size_range: tuple[float, float] = (0.8, 1.25)
    # Stages of the fit: ``sigma_px``, share of the way that a point moves in an iteration, and
    # iterations. Chosen on the street people of even-numbered photographs.
    fit_stages: tuple[tuple[float, float, int], ...] = ((14.0, 0.7, 4), (7.0, 0.7, 10))
    # Total share of the way to the landmarks' depths by which the fit moves joints
    depth_share: float = 0.6


@dataclass(frozen=True)
class RotationParameters:
    """Which in-plane rotations of a query are searched; see :mod:`index.candidates`."""

    # Ratio of width to height from which a silhouette is searched both as it is and rotated
    nearly_square: float = 0.75
    # With landmarks, rotations are searched in multiples of this
    step_deg: float = 15.0
    # Most rotations that are searched with landmarks
    max_rotations: int = 2
    # Smallest share of the entries near the landmarks for which a rotation is searched
    min_share: float = 0.2


@dataclass(frozen=True)
class RankingParameters:
    """The order of hypotheses; see :mod:`index.ranking`."""

    # Weight of the joints' log-likelihood relative to the logarithm of the distance, in the order
    # of hypotheses. Like ``support_weight``, it was chosen on clips and bodies that neither the
    # network nor the experiment on simulated silhouettes has, and is stored with a network.
    order_weight: float = 3.0
    # The same weight for the candidates from which hypotheses are made
    support_weight: float = 1.0
    # Standard deviation of a joint from its place in a mode: columns and rows in pixels, depth in
    # metres. It was chosen on every second clip of the experiment on simulated silhouettes; 2 to 4
    # pixels do equally well.
    spread: tuple[float, float, float] = (3.0, 3.0, 0.04)
    # Hypotheses share the probability by the inverse of their distances to this power
    share_power: float = 4.0
    # Weight of the log distance of the descriptors against a hypothesis, beside the log-likelihood
    # of the landmarks. Like ``side_weight``, it was chosen on people in even-numbered photographs.
    distance_weight: float = 4.0
    # Weight of the log odds of a hypothesis's sides
    side_weight: float = 0.3
    # Few people are tilted in the picture: a tilt of this size makes a hypothesis 1/e as likely
    tilt_scale_deg: float = 60.0


@dataclass(frozen=True)
class PostureRules:
    """Thresholds of :func:`index.posture.classify_postures`.

    Heights and lengths are in legs (thigh and shank), heights from the lowest joint.
    """

    # Smallest tilt of the trunk of a person lying or on all fours
    min_horizontal_deg: float = 55.0
    # Largest height of the pelvis and the chest of a person lying
    max_lying_height: float = 0.5
    # Largest height of the lowest hand or elbow of a person on all fours
    max_hand_height: float = 0.3
    # Largest height of the pelvis of a person on all fours
    max_crawling_height: float = 0.85
    # Height of the pelvis below which the legs are not standing
    max_lowered_height: float = 0.8
    # Largest height of a pelvis that rests on the floor
    max_floor_height: float = 0.3
    # Largest height of a knee on the floor
    max_knee_height: float = 0.2
    # Largest height of a knee on the floor above its ankle
    max_shank_rise: float = 0.2
    # Horizontal distance of the centre of mass from the feet beyond which something else carries
    # the body
    min_unsupported: float = 0.15
    # With ``max_seated_trunk_deg`` and ``min_seat_height``: a person whose thighs are this level,
    # with the trunk this upright and the pelvis at the height of a seat, sits even if the feet
    # could carry the body
    max_level_thigh_deg: float = 25.0
    max_seated_trunk_deg: float = 20.0
    min_seat_height: float = 0.5
    # Least tilt of a trunk that is bent over standing legs
    min_bent_deg: float = 45.0
    # Least tilt of a trunk that is bent over lowered legs
    min_bent_low_deg: float = 60.0
    # Least horizontal speeds, metres per second
    min_walking_speed: float = 0.5
    min_running_speed: float = 2.2
    # Steepest elevation of a camera
    max_elevation_deg: float = 70.0


MATCHING = MatchParameters()
MODES = ModeParameters()
KEYPOINTS = KeypointParameters()
ROTATIONS = RotationParameters()
RANKING = RankingParameters()
POSTURE_RULES = PostureRules()
