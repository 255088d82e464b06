"""The numbers of vision that were set by hand, by topic; :data:`DEFAULTS` holds those in use.

Numbers that a network's architecture fixes stand beside its decoder, and those fitted to data in
``models/fitted.json``. Units are in the names: ``_px`` pixels, ``_iou`` intersection over union;
shares, scores and probabilities have none.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ImageParameters:
    """How images and masks are decoded."""

    # A picture is dark if this percentile of its values is lower.
    bright_percentile: float = 99.0
    dark_below: float = 20.0
    # The range of 16-bit values that is stretched excludes outliers of this percentage, and is at
    # least this wide: a narrower one would be noise.
    outlier_percentile: float = 0.1
    min_used_range: int = 64
    sampled_px: int = 20_000  # Sample for percentiles, which take half a millisecond.
    max_missing_share: float = 0.5  # A JPEG of which more is missing is refused.
    max_labels: int = 100  # With more values, an image is a mask with soft edges, not a crowd.
    # Most pairs of neighbouring pixels with different labels: this number and, above the third
    # number, also this share of the pixels. Fifty people who fill a frame of 12 megapixels have
    # 400,000, a thirtieth of the pixels; noise has two for each pixel.
    max_label_changes: int = 1_000_000
    max_label_change_share: float = 0.5
    few_label_changes: int = 10_000
    lossy_threshold: int = 128  # Value from which a pixel of a lossy mask is the person's.
    # Lossy compression moves black and white by up to this, except at edges; pixels in between may
    # be this share of those of the person.
    lossy_certainty: int = 48
    max_lossy_between: float = 0.5
    lossy_channel_difference: int = 16  # Channels of a lossy grey image differ by up to this.
    # Reads that an image may take, and further bytes for each further read. Pillow keeps every
    # segment of a JPEG: 16 MB of empty ones would take ten seconds and 700 MB.
    free_reads: int = 10_000
    bytes_per_read: int = 500


@dataclass(frozen=True)
class TilingParameters:
    """The sizes at which MoveNet sees a frame."""

    # Largest sides of the overview: a camera with more pixels does not cost more.
    overview_px: tuple[int, int] = (640, 352)
    max_enlargement: float = 1.5  # Largest factor by which small frames are enlarged.
    min_side_px: int = 12  # Shortest side of the overview; thinner frames hold nobody.
    # Height of the smallest person wanted by default, as a share of the frame's height.
    min_person_share: float = 1 / 12
    # Gain in resolution over the overview up to which tiles add nothing.
    min_gain: float = 1.1
    # Largest side and area of the frame at the resolution of the tiles; they bound the time.
    max_fine_side_px: int = 1280
    max_fine_px: int = 1280 * 720
    max_tile_px: int = 160_000  # Area of a tile as MoveNet sees it, which bounds the memory.
    max_tiles_per_side: int = 8
    # Overlap of tiles, so that a person at a seam is whole in the next tile or the overview.
    overlap_px: int = 96

    @property
    def min_person_px(self) -> float:
        """Height at which MoveNet sees the smallest wanted person."""
        return self.overview_px[1] * self.min_person_share


@dataclass(frozen=True)
class DetectorParameters:
    """Detection by both networks, with HOG beside them."""

    min_score: float = 0.3  # Probability from which a detection is reported.
    # Overlap from which two boxes show one person; two people side by side reach 0.3.
    nms_iou: float = 0.4
    min_movenet_score: float = 0.02  # MoveNet's lower scores are ignored.
    # Least distance of scores from 0 and 1 when their log odds are taken.
    min_probability: float = 1e-4
    # Log odds added to a detection where a person was seen a moment ago. People do not vanish, but
    # a falling person is blurred, and then lies in a pose that detectors rarely recognise.
    expected_log_odds: float = 1.0
    # Share of a box that must be within reach of that person.
    min_expected_share: float = 0.5
    # Longer side of a box, in the overview, from which people are taken from the overview; smaller
    # ones are taken from the tiles, which separate two people side by side.
    large_person_px: float = 96.0
    seam_px: float = 4.0  # A box that ends so close to a seam, as MoveNet sees it, is cut.
    min_body_score: float = 0.3  # Least score of BlazePose's detector.
    # Presence from which a detection of BlazePose alone is a person: walls and trees stay below
    # 0.1, most people are above 0.9.
    min_presence: float = 0.5
    # Size of BlazePose's window relative to the one about MoveNet's box if both show one person.
    same_size: tuple[float, float] = (0.4, 2.5)


@dataclass(frozen=True)
class HogParameters:
    """Detection by OpenCV's HOG."""

    min_score: float = 0.2  # Probability from which HOG alone reports a detection.
    pyramid_step: float = 1.15  # Coarser than the usual 1.05, at half the time.
    # Height of the largest person searched for, as a share of the frame's height.
    max_person_share: float = 1.15
    border_px: int = 16  # Padding in the trained window, so that people at the border fill one.
    box_scale: float = 1.06  # Windows in which a box is scored, relative to the box.
    min_margin: float = -5.0  # Lower margins are raised to this.
    search_person_px: float = 50.0  # Frames are reduced until the smallest person has this height.
    # Smaller people are not searched for: in a frame of a few rows, a share of the height is next
    # to nothing.
    min_person_px: float = 16.0
    nms_iou: float = 0.4  # Overlap from which two boxes show one person.
    # Two boxes show a part and the whole of one body if they share this much of the smaller box and
    # their axes are no farther apart than this share of the wider box.
    part_share: float = 0.8
    part_distance: float = 0.3
    # Overlap with a person's best box above which a box is used in the person's mean box.
    mean_iou: float = 0.6
    mean_margin: float = 0.1  # Added to the margins that weight this mean, which may be 0.


@dataclass(frozen=True)
class KeypointParameters:
    """Decoding of MoveNet's detections, and of its keypoints for one person in a box."""

    max_people: int = 60  # Most people found in one pass of the network.
    min_centre_score: float = 0.03
    min_box_cells: float = 0.25  # Sides of a box in heatmap cells; smaller ones are empty.
    input_px: tuple[int, int] = (256, 160)  # Window of one person, the longer side along them.
    window_scale: float = 1.25  # Size of that window relative to the person's box.
    min_iou: float = 0.2  # Overlap with the person's box from which a detection may be theirs.


@dataclass(frozen=True)
class ReadingParameters:
    """Choice among readings of the landmark network, and their fusion with MoveNet's keypoints.

    Distances are in sizes of the body.
    """

    good_quality: float = 0.85  # From this quality on, no further window is tried.
    # Below this quality, the window that the best reading points to is read.
    doubtful_quality: float = 0.6
    # Weights in the quality, beside the agreement with MoveNet.
    presence_weight: float = 0.3
    drift_weight: float = 1.0
    agreement_distance: float = 0.15  # Distance up to which both networks agree on a keypoint.
    unknown_agreement: float = 0.6  # Agreement assumed if MoveNet finds nobody.
    # Weight of a keypoint of score 1, relative to the landmark with which it agrees.
    keypoint_weight: float = 2.0
    # Score from which hips and shoulders show the direction of the trunk.
    min_trunk_score: float = 0.15
    min_visible_score: float = 0.25  # Score from which a keypoint of MoveNet is visible.
    # Distance from the frame's border within which landmarks are at most as visible as MoveNet's
    # keypoints.
    border_distance: float = 0.3
    hips_to_feet: float = 1.7  # Distance from hips to feet, relative to the trunk.
    # If the trunk leans by an angle between these, a window that is not turned is tried as well: in
    # windows turned to a leaning trunk, the network sometimes exchanges left and right.
    min_lean_deg: float = 15.0
    max_lean_deg: float = 60.0


@dataclass(frozen=True)
class SilhouetteParameters:
    """Silhouettes from the masks of the landmark network."""

    # Least probability of a person's pixels; chosen on even-numbered photographs.
    min_probability: float = 0.5
    max_side_px: int = 384  # Largest size at which masks are drawn and cleaned.
    min_cover: float = 0.5  # Least share of a person's pixel that the drawn mask covers.
    # Boxes that end this close to the frame's edge are extended to it: the mask shows better than
    # the box whether the body continues.
    edge_px: float = 5.0
    min_fill: float = 0.12  # Filled share of the box below which the network saw nobody.
    # Landmarks of at least this visibility widen a box, by a margin that is a share of its longer
    # side.
    min_visibility: float = 0.5
    landmark_margin: float = 0.04
    # Distance from the ears to the crown, relative to that from the shoulders to the ears.
    crown: float = 0.7
    min_part: float = 0.1  # Area relative to the largest part; smaller parts are dropped.
    max_hole: float = 0.01  # Area relative to the mask; larger holes stay.


@dataclass(frozen=True)
class TruncationParameters:
    """Whether the frame's border or another person cuts a body.

    Chosen on even-numbered photographs, see docs/history.md.
    """

    # A silhouette ends at an edge if it is as near as this many pixels, or this share of its longer
    # side: silhouettes are no more precise.
    border_px: float = 1.0
    border_share: float = 0.01
    # Share of its extent along an edge above which a silhouette is cut: a shoe that just reaches
    # the last row is not.
    min_border_run: float = 0.1
    # Distance from the frame's edge within which it may cut a box, as a share of the longer side.
    unseen_end_share: float = 0.05
    min_keypoint_score: float = 0.3  # Score from which a keypoint is seen.
    max_cover: float = 0.05  # Share of a whole person's box that a nearer person may cover.
    box_fill: float = 0.5  # Share of a box that a person without a silhouette fills.


@dataclass(frozen=True)
class BackgroundParameters:
    """Differences from a picture of the empty scene, in grey levels."""

    max_px: int = 1920 * 1080  # Larger frames are reduced: one of 12 megapixels took 13 s and 2 GB.
    blur_px: float = 0.8  # Standard deviation of the blur before frames are compared.
    # Difference, in standard deviations of the noise, from which a pixel has certainly changed, and
    # from which a pixel connected to such a one has changed.
    certain_distance: float = 8.0
    possible_distance: float = 4.0
    min_noise: float = 2.0  # Least noise: compression alone leaves this much.
    # Share of the background's local contrast that counts as noise: vibration and focus breathing
    # move edges.
    contrast_noise: float = 0.25
    exposure_range: tuple[float, float] = (4.0, 250.0)  # Pixels outside are not used to fit it.
    min_exposure_samples: int = 100
    # The fit of the exposure is repeated on the samples whose error is within this multiple of the
    # median error, or within this many grey levels: people are outliers.
    exposure_rounds: int = 4
    exposure_outlier: float = 2.5
    min_exposure_error: float = 3.0
    # A shadow leaves a share of the light in this range, alike in all channels, and the texture.
    shadow_light: tuple[float, float] = (0.45, 0.98)
    max_shadow_tint: float = 0.06
    max_shadow_unevenness: float = 0.05
    min_cover: float = 0.45  # Share of the nearby difference that half a pixel of a person shows.
    min_height_share: float = 0.8  # Height of a region, relative to the smallest person wanted.
    height_per_gap: float = 12.0  # Height of that person relative to gaps closed within a body.
    # Scores of a region, as a standing or walking body: by its width over height, 0 outside the
    # range, and by the share of its box that it fills, 0 below the range.
    aspect: tuple[float, ...] = (0.15, 0.25, 0.6, 1.2)
    aspect_score: tuple[float, ...] = (0.3, 1.0, 1.0, 0.2)
    fill: tuple[float, ...] = (0.2, 0.4)
    fill_score: tuple[float, ...] = (0.4, 1.0)
    max_score: float = 0.9  # A region of change is never a person for certain.
    min_part: float = 0.1  # Area relative to the largest part; smaller parts are dropped.
    max_hole: float = 0.05  # Area relative to the mask; larger holes stay.


@dataclass(frozen=True)
class VisionParameters:
    """All parameters of vision."""

    images: ImageParameters = ImageParameters()
    tiling: TilingParameters = TilingParameters()
    detector: DetectorParameters = DetectorParameters()
    hog: HogParameters = HogParameters()
    keypoints: KeypointParameters = KeypointParameters()
    reading: ReadingParameters = ReadingParameters()
    silhouettes: SilhouetteParameters = SilhouetteParameters()
    truncation: TruncationParameters = TruncationParameters()
    background: BackgroundParameters = BackgroundParameters()


DEFAULTS = VisionParameters()
