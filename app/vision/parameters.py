"""The hand-set numbers of vision, one class per topic.

Numbers fitted to data are in ``models/fitted.json``. Those that belong to a network's architecture
stand beside its decoder.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ImageParameters:
    """Decoding of images and masks."""

    max_labels: int = 100
    """A label image with more values is a mask with soft edges, not a crowd."""

    lossy_threshold: int = 128
    """Value from which a pixel of a JPEG or lossy WebP mask is the person's."""

    lossy_channel_difference: int = 16
    """Channels of a lossy grey image differ by up to this."""

    free_reads: int = 10_000
    """Reads that any image may take, however small."""

    bytes_per_read: int = 500
    """Least average length of further reads. Pillow keeps each JPEG segment: 16 MB of empty ones
    would take ten seconds and 700 MB."""


@dataclass(frozen=True)
class TilingParameters:
    """The sizes at which MoveNet sees a frame."""

    overview_px: tuple[int, int] = (640, 352)
    """Longest and shortest side of the overview: a camera of more pixels does not cost more."""

    max_enlargement: float = 1.5
    """Factor by which a small frame is enlarged at most."""

    min_side_px: int = 12
    """Shorter side of the overview below which a frame is too thin to hold a person."""

    min_person_share: float = 1 / 12
    """Height of the smallest wanted person by default, as a share of the frame's height."""

    min_gain: float = 1.1
    """Resolution of the tiles relative to the overview up to which they add nothing."""

    max_fine_side_px: int = 1280
    max_fine_px: int = 1280 * 720
    """Longer side and area of the frame at the tiles' resolution, which bound the time."""

    max_tile_px: int = 160_000
    """Area of a tile as MoveNet sees it, which bounds the memory."""

    max_tiles_per_side: int = 8

    overlap_px: int = 96
    """Overlap of tiles as MoveNet sees them: a person at a seam is whole in the next tile or in the
    overview."""

    @property
    def min_person_px(self) -> float:
        """Height at which MoveNet sees the smallest wanted person."""
        return self.overview_px[1] * self.min_person_share


@dataclass(frozen=True)
class DetectorParameters:
    """Detection by both networks and HOG."""

    min_score: float = 0.3
    """Least probability that is reported."""

    nms_iou: float = 0.4
    """IoU from which two boxes are one person; two people walking side by side reach 0.3."""

    min_movenet_score: float = 0.02
    """Score below which MoveNet's detections are ignored."""

    min_probability: float = 1e-4
    """Bound on MoveNet's score, and on its complement, before log odds are taken."""

    expected_log_odds: float = 1.0
    """Bonus for a detection where a person was seen a moment ago. People do not vanish, but one who
    falls is blurred, then lies in a pose that detectors hardly know."""

    min_expected_share: float = 0.5
    """Share of a box within reach of an expected person from which it gets the bonus."""

    large_person_px: float = 96.0
    """Height in the overview from which people are taken from it; smaller ones are taken from the
    tiles, which separate two people walking side by side."""

    seam_px: float = 4.0
    """A box that ends within this distance of a tile's inner edge, as MoveNet sees it, is cut."""

    min_body_score: float = 0.3
    """Score from which detections of BlazePose count."""

    min_presence: float = 0.5
    """Presence from which a detection of BlazePose alone is a person: walls and trees stay below
    0.1, most people are above 0.9."""

    same_size: tuple[float, float] = (0.4, 2.5)
    """Ratio of BlazePose's window to the window about MoveNet's box within which both are about the
    same person."""


@dataclass(frozen=True)
class HogParameters:
    """Detection by OpenCV's HOG."""

    min_score: float = 0.2
    """Least probability that HOG alone reports."""

    pyramid_step: float = 1.15
    """Ratio of two levels of the pyramid; coarser than the usual 1.05 at half the time."""

    max_person_share: float = 1.15
    """Height of the largest person searched for, as a share of the frame's height."""

    border_px: int = 16
    """Padding about the frame, in pixels of a window, so that people at its border fill one."""

    box_scale: float = 1.06
    """A box is judged in windows this much larger than the trained ones."""

    min_margin: float = -5.0
    """Lower bound of margins."""

    search_person_px: float = 50.0
    """Frames are reduced until the smallest wanted person has this height."""

    min_person_px: float = 16.0
    """Frames are not enlarged to find smaller people: in a frame of a few rows, a share of the
    height is next to nothing."""

    nms_iou: float = 0.4
    """IoU from which two boxes are one person."""

    part_share: float = 0.8
    part_distance: float = 0.3
    """Two boxes are of one body where one holds this share of the other and their axes are no
    farther apart than this share of the wider one: a head and trunk within a whole body."""

    mean_iou: float = 0.6
    """IoU with the best box of a person above which a box counts towards the mean."""

    mean_margin: float = 0.1
    """Added to margins, which may be 0, where they weight that mean."""


@dataclass(frozen=True)
class KeypointParameters:
    """MoveNet's detections, and its keypoints of one person in a box."""

    max_people: int = 60
    """Detections per pass of the network."""

    min_centre_score: float = 0.03
    """Score of a centre below which it is no detection."""

    min_box_cells: float = 0.25
    """Sides of a box in heatmap cells below which it is empty."""

    input_px: tuple[int, int] = (256, 160)
    """Sides of the window as the network sees it, the longer one along the person."""

    window_scale: float = 1.25
    """Size of the window relative to the person's box."""

    min_iou: float = 0.2
    """IoU with the person's box from which a detection may be that person."""


@dataclass(frozen=True)
class ReadingParameters:
    """Choice among the landmark network's readings, and their fusion with MoveNet's keypoints."""

    good_quality: float = 0.85
    """Quality from which no further window is tried."""

    presence_weight: float = 0.3
    drift_weight: float = 1.0
    """Weights of presence and drift in the quality, beside the agreement with MoveNet."""

    agreement_distance: float = 0.15
    """Distance, in sizes of the body, within which both networks agree about a keypoint."""

    unknown_agreement: float = 0.6
    """Agreement where MoveNet finds nobody."""

    keypoint_weight: float = 2.0
    """Weight of a MoveNet keypoint of score 1 against the landmark that it agrees with."""

    min_trunk_score: float = 0.15
    """Score from which hips and shoulders give the direction of the trunk."""

    min_visible_score: float = 0.25
    """Score from which a MoveNet keypoint is visible."""

    border_distance: float = 0.3
    """Distance from the frame's border, in sizes of the body, within which a landmark is at most as
    visible as MoveNet's keypoint."""

    hips_to_feet: float = 1.7
    """Distance from hips to feet relative to the trunk."""


@dataclass(frozen=True)
class SilhouetteParameters:
    """Silhouettes from the landmark network's masks."""

    min_probability: float = 0.5
    """Probability from which a pixel is the person's; chosen on even-numbered photographs."""

    max_side_px: int = 384
    """Longer side at which masks are drawn and cleaned."""

    min_cover: float = 0.5
    """Share of a pixel that the drawn mask covers from which the pixel is the person's."""

    edge_px: float = 5.0
    """Boxes that end this close to the frame's edge are extended to it: the mask shows better than
    the box whether the body goes on."""

    min_fill: float = 0.12
    """Share of the box below which the network did not see the person."""

    min_visibility: float = 0.5
    landmark_margin: float = 0.04
    """Visibility from which landmarks widen a box, and the margin about them as a share of it."""

    min_part: float = 0.1
    max_hole: float = 0.01
    """Least area of a part kept, relative to the largest part, and most of a hole filled, relative
    to the mask."""


@dataclass(frozen=True)
class TruncationParameters:
    """Whether the frame's border or another person cuts a body.

    Chosen on even-numbered photographs: docs/results/truncation.md.
    """

    border_px: float = 1.0
    border_share: float = 0.01
    """A silhouette as close to the edge as this many pixels, or this share of its longer side, ends
    at it; silhouettes are no more precise."""

    min_border_run: float = 0.1
    """Share of its extent along the border above which a silhouette is cut: a shoe that just
    reaches the last row is not."""

    unseen_end_share: float = 0.05
    """A box whose head or feet are unseen ends at the edge within this share of its longer side."""

    min_keypoint_score: float = 0.3
    """Score from which a keypoint is seen."""

    max_cover: float = 0.05
    """Share of a person's box that somebody nearer may cover."""

    box_fill: float = 0.5
    """Share of a box taken for covered where the person in it has no silhouette."""


@dataclass(frozen=True)
class BackgroundParameters:
    """Differences from a picture of the empty scene.

    Distances are in standard deviations of the noise, brightness in grey levels.
    """

    max_px: int = 1920 * 1080
    """Larger frames are reduced to this area: one of 12 megapixels took 13 s and 2 GB."""

    blur_px: float = 0.8
    """Standard deviation of the blur before frames are compared."""

    certain_distance: float = 8.0
    possible_distance: float = 4.0
    """Distances from which a pixel has changed, and has changed if connected to such a pixel."""

    min_noise: float = 2.0
    """Compression alone leaves this much."""

    contrast_noise: float = 0.25
    """Share of the background's local contrast that counts as noise: edges move with vibration and
    focus breathing."""

    exposure_range: tuple[float, float] = (4.0, 250.0)
    """Pixels darker or brighter than this say nothing about the exposure."""

    min_exposure_samples: int = 100
    """Number of sampled pixels below which the exposure is not fitted."""

    exposure_rounds: int = 4
    exposure_outlier: float = 2.5
    min_exposure_error: float = 3.0
    """The fit is repeated on pixels whose error is within this multiple of the median, or within
    the least error: people are outliers."""

    shadow_light: tuple[float, float] = (0.45, 0.98)
    max_shadow_tint: float = 0.06
    max_shadow_unevenness: float = 0.05
    """A shadow dims all channels alike, to a share of the light in this range, and leaves the
    texture."""

    min_cover: float = 0.45
    """Share of the nearby difference that a border pixel shows if the person covers half of it."""

    min_height_share: float = 0.8
    """Height of a region relative to the smallest wanted person from which it may be one."""

    height_per_gap: float = 12.0
    """Height of the smallest wanted person relative to the gaps that are closed within a body."""

    aspect: tuple[float, ...] = (0.15, 0.25, 0.6, 1.2)
    aspect_score: tuple[float, ...] = (0.3, 1.0, 1.0, 0.2)
    """Scores by width over height of a standing or walking body; 0 outside the range."""

    fill: tuple[float, ...] = (0.2, 0.4)
    fill_score: tuple[float, ...] = (0.4, 1.0)
    """Scores by the share of its box that a body fills; 0 below the range."""

    max_score: float = 0.9
    """A region of change is never a person for certain."""

    min_part: float = 0.1
    max_hole: float = 0.05
    """Least area of a part kept, relative to the largest part, and most of a hole filled, relative
    to the mask."""


@dataclass(frozen=True)
class VisionParameters:
    """All of them."""

    images: ImageParameters = ImageParameters()
    tiling: TilingParameters = TilingParameters()
    detector: DetectorParameters = DetectorParameters()
    hog: HogParameters = HogParameters()
    keypoints: KeypointParameters = KeypointParameters()
    reading: ReadingParameters = ReadingParameters()
    silhouettes: SilhouetteParameters = SilhouetteParameters()
    truncation: TruncationParameters = TruncationParameters()
    background: BackgroundParameters = BackgroundParameters()


VISION = VisionParameters()
"""The values that the service uses."""
