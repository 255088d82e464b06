"""Hand-set numbers of the build of an index, each with its unit and its reason.

The numbers of entries, bodies and views are arguments of a build (:class:`.builder.Plan`); the
avatars and the held-out clips are in :mod:`.splits`.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class MotionParameters:
    """Frames of a clip that are left out, and its speed; see :mod:`index.build.motion`."""

    # Mean joint angle from the zero pose (arms out, legs straight) below which a frame is one: the
    # calibration poses at the start of some clips stay below 5.8, living ones above 6.1
    t_pose_below_deg: float = 6.0
    # A bone is broken that turns more than this in 1/30 s, and so many times as far as around it
    jump_above_deg: float = 45.0
    jump_ratio: float = 4.0
    # Frames between two jumps that are as broken as the jumps: a bone flipped and flipped back
    short_run: int = 8
    # Frames before and after over which speed is measured: half a second at 30 fps
    speed_window: int = 7


@dataclass(frozen=True)
class PoseParameters:
    """Poses read, laid on the ground and chosen; see :mod:`.poses` and :mod:`.builder`."""

    # Tilt of the trunk up to which a frame counts as upright
    upright_within_deg: float = 25.0
    # Subjects with fewer upright frames are given the median pitch of the others
    min_upright_frames: int = 100
    # Pelvis and chest of a lying body are at most this far above its lowest joint
    trunk_below_m: float = 0.3
    # Share of the chosen poses that are recorded in low postures: it takes nearly all such frames
    low_share: float = 0.19
    # Share of the chosen poses that are laid on the ground
    laid_down_share: float = 0.33
    # Poses laid down for each that is chosen: about two of three lie on their trunk
    laid_down_tried: int = 3


@dataclass(frozen=True)
class ViewParameters:
    """Cameras; see :mod:`index.build.views`."""

    # From a little below the height of the pelvis to a steep surveillance view
    elevations_deg: tuple[float, float] = (-5.0, 60.0)
    # The same of bodies that lie or crawl
    ground_elevations_deg: tuple[float, float] = (5.0, 70.0)
    # From a room to a car park
    distances_m: tuple[float, float] = (3.0, 20.0)
    # Cameras are rolled a little
    roll_std_deg: float = 2.0
    # Roll above which a camera was rolled for a silhouette wider than high
    max_own_roll_deg: float = 30.0
    # Cameras sampled for each one kept of a pose laid down: a body that lies across the picture
    # looks like one that stands
    foreshortened_of: int = 2


@dataclass(frozen=True)
class RenderingParameters:
    """Shards of the simulation, and the cluster that may draw them; see :mod:`.simulate`."""

    # Poses rendered at a time: a second or two of work
    shard_poses: int = 100
    # Shards handed out at a time: enough for the threads of a large cluster, 40 MB of transforms
    max_pending: int = 128
    # Seconds that a scheduler may take to answer
    connect_s: float = 5.0
    # Seconds that the first worker may take to join
    first_worker_s: float = 60.0


@dataclass(frozen=True)
class NoiseParameters:
    """Faults of silhouettes cut out of photographs; see :mod:`index.build.noise`."""

    # Pixels around the silhouette for an outline that moves outwards
    margin_px: int = 8
    # Length of an error along the outline (one standard deviation)
    grain_px: float = 3.5
    # Range of the standard deviation of the shift across the outline of an upright person
    outline_std_px: tuple[float, float] = (0.6, 2.4)
    # Mean distance of the outline outside the body's
    wider_px: float = 0.4
    # Share of silhouettes with filled gaps or background
    extra_share: float = 0.4
    # Share of silhouettes that lack a part
    missing_share: float = 0.3
    # Range of the radius of a filled gap
    gap_px: tuple[int, int] = (3, 8)
    # Range of the area of background that sticks to the body, as a share of the body's
    blob_share: tuple[float, float] = (0.02, 0.12)
    # Range of the radius that is cut off around a hand, a foot or the head, as a share of the
    # height of the frame
    cut_share: tuple[float, float] = (0.03, 0.09)


@dataclass(frozen=True)
class LearningParameters:
    """What the descriptor is learned from; see :mod:`index.build.descriptor_learning`."""

    # Silhouettes whose nearest skeletons are searched
    anchors: int = 20_000
    # Nearest skeletons of each
    nearest: int = 5
    # Weight of the faults of real silhouettes against differences of body, clothes and pose
    noise_weight: float = 0.25
    # Joint differences, in the normalised frame and in space, with equal weight
    scale_px: float = 5.0
    scale_m: float = 0.11


@dataclass(frozen=True)
class NetworkParameters:
    """What the network of joints is shown; see :mod:`.joint_training` and :mod:`.reranker`."""

    # Share of the silhouettes that are also shown degraded
    degraded_share: float = 0.5
    # Share of the silhouettes whose border pixels are flipped at random
    flipped_share: float = 0.25
    # Largest share of the border pixels that are flipped
    max_flips: float = 0.2
    # Silhouettes that show how large values become within the network
    scale_sample: int = 400
    # Passes over all silhouettes, as a share of those without the clips kept for the confidence
    finishing_share: float = 0.2


MOTION = MotionParameters()
POSES = PoseParameters()
VIEWS = ViewParameters()
RENDERING = RenderingParameters()
NOISE = NoiseParameters()
LEARNING = LearningParameters()
NETWORK = NetworkParameters()
