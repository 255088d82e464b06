"""The public contract: the models that clients send and receive, with units and examples."""

import math
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    FiniteFloat,
    with_config,
)
from typing_extensions import TypedDict

from app.estimation.posture import PostureLabel
from app.estimation.results import FacingSource, Source
from app.estimation.upload import MIN_BOX_PX
from app.vision.images import ImageWarning
from index.posture import PostureName

KeypointSetName = Literal["native", "cmu19", "coco17", "h36m17"]
ObservedSetName = Literal["coco17", "blazepose33"]
SilhouetteForm = Literal["none", "rle", "polygon"]
JointForm = Literal["full", "compact", "none"]

Probability = Annotated[FiniteFloat, Field(ge=0, le=1)]

# The digits of what is written. They are few enough that every processor gives the same answer.
METRE_DIGITS, PIXEL_DIGITS = 4, 2
MIN_FOV_DEG = 0.01
"""Least field of view that is written: that of a frame of one column could be rounded to 0."""


def rounding(digits: int, least: float = -math.inf) -> BeforeValidator:
    """Round what is written. It comes after the limits of a value, or they go undocumented."""
    return BeforeValidator(lambda value: max(least, round(value, digits)))


Score = Annotated[Probability, rounding(4)]
Seconds = Annotated[FiniteFloat, rounding(4)]
Duration = Annotated[FiniteFloat, Field(ge=0), rounding(4)]
_Pixels = Annotated[FiniteFloat, rounding(PIXEL_DIGITS)]
_Side = Annotated[FiniteFloat, Field(gt=0), rounding(PIXEL_DIGITS, MIN_BOX_PX)]
_Metres = Annotated[FiniteFloat, rounding(2)]
_Degrees = Annotated[FiniteFloat, rounding(2)]
_Milliseconds = Annotated[FiniteFloat, Field(ge=0), rounding(3)]


class Model(BaseModel):
    """Base of all models: immutable, unknown fields forbidden, also made of objects alike."""

    model_config = ConfigDict(frozen=True, extra="forbid", from_attributes=True)


FRAME = (
    "The photograph: JPEG, PNG, WebP, BMP, TIFF or GIF. Its EXIF orientation is applied; all "
    "pixels of the reply refer to the turned image."
)


class FrameUpload(Model):
    """A frame and, if known, where its people are."""

    frame: bytes | None = Field(None, description=f"{FRAME} Required unless a mask is given.")
    mask: bytes | None = Field(
        default=None,
        description="Where the people are: an image of the frame's size, 0 background, k = person "
        "k; one with two values, or with soft edges, is one person. PNG keeps the labels; a JPEG "
        "has to be black and white. Without a frame, poses follow from the silhouettes alone.",
    )
    background: bytes | None = Field(
        default=None,
        description="The empty scene, in the frame's size and from the same fixed camera: people "
        "are where the frame differs from it.",
    )
    boxes: str | None = Field(
        default=None,
        description="Where the people are: a JSON list of `[x, y, width, height]` in pixels "
        "of the frame, such as `[[401, 120, 61, 148]]`. With a background, what differs from it is "
        "cut out inside them; a mask excludes both.",
    )


class Problem(Model):
    """An error, as RFC 9457 describes it."""

    type: str = Field(description="`about:blank`: the status says it.", examples=["about:blank"])
    title: str = Field(description="The status in words.", examples=["Unprocessable Entity"])
    status: int = Field(description="The HTTP status.", examples=[422])
    detail: str = Field(
        description="What is wrong with this request, in one sentence.",
        examples=["expected a mask of 768x576 pixels like the frame, got 640x480"],
    )
    reason: str = Field(description="One word for programs: see running.md.", examples=["misfit"])
    field: str | None = Field(None, description="The field at fault, if any.", examples=["mask"])


# Points are dictionaries, validated with the model that contains them: a reply has hundreds of
# points, and creating them as models would take as long as everything else.
@with_config(ConfigDict(extra="forbid"))
class Point2D(TypedDict):
    """A point in an image, from the centre of the top-left pixel."""

    x: Annotated[FiniteFloat, Field(description="Pixels to the right.", examples=[431.2])]
    y: Annotated[FiniteFloat, Field(description="Pixels down.", examples=[190.4])]


@with_config(ConfigDict(extra="forbid"))
class Point3D(TypedDict):
    """A point in camera axes, origin at the pelvis."""

    x: Annotated[FiniteFloat, Field(description="Metres to the right.", examples=[0.12])]
    y: Annotated[FiniteFloat, Field(description="Metres down.", examples=[-0.48])]
    z: Annotated[FiniteFloat, Field(description="Metres away from the camera.", examples=[0.05])]


class Box(Model):
    """A person's bounding box."""

    x: _Pixels = Field(description="Left edge, pixels of the frame.", examples=[401.0])
    y: _Pixels = Field(description="Top edge, pixels of the frame.", examples=[120.0])
    width: _Side = Field(description="Pixels of the frame.", examples=[61.0])
    height: _Side = Field(description="Pixels of the frame.", examples=[148.0])


class ImageSize(Model):
    """Size of the frame after its EXIF orientation was applied."""

    width: int = Field(description="Pixels.", examples=[768])
    height: int = Field(description="Pixels.", examples=[576])


class Image(ImageSize):
    """The frame after its EXIF orientation was applied, and its camera."""

    fov_deg: Annotated[FiniteFloat, Field(gt=0, lt=180), rounding(2, MIN_FOV_DEG)] = Field(
        description="The horizontal field of view that was used, degrees.",
        examples=[60.0],
    )
    fov_given: bool = Field(
        description="Whether the caller gave it. Otherwise it is assumed: 60 degrees across the "
        "longer side of the frame.",
        examples=[False],
    )
    warnings: list[ImageWarning] = Field(
        description="What may impair the result. `crowded`: there are more people than are "
        "returned, too many or for want of time; `dark`: too dark to show much; `obstructed`: the "
        "camera's usual view is covered, out of focus or turned away; `stretched`: a picture of 16 "
        "bits a channel used only part of its range; `truncated`: the end of a JPEG, or part of a "
        "TIFF, is missing; `damaged`: the video has lost data of this frame, or of one that it is "
        "predicted from; `zone_outside`: a zone lies wholly outside. More may be added.",
        examples=[[]],
    )


class Position(Model):
    """Where a person is: metres from the camera to the pelvis, in the camera's axes."""

    x: _Metres = Field(description="Metres to the right.", examples=[0.4])
    y: _Metres = Field(description="Metres down.", examples=[0.2])
    z: _Metres = Field(description="Metres away from the camera.", examples=[6.1])
    sd: Annotated[FiniteFloat, Field(ge=0), rounding(2)] = Field(
        description="Standard deviation along the line of sight, metres: the distance follows from "
        "the size of the body in the image, and people differ by a tenth.",
        examples=[0.6],
    )


class Bone(Model):
    """A line between two keypoints."""

    parent: int = Field(description="Position in the list of keypoint names.", examples=[0])
    child: int = Field(description="Position in the list of keypoint names.", examples=[1])


class Keypoints(Model):
    """The keypoints that a reply lists, and their order."""

    set: KeypointSetName = Field(description="The requested set.", examples=["native"])
    names: list[str] = Field(
        description="Names in the order of every list of joints; left and right are the "
        "person's own.",
        examples=[["pelvis", "spine", "chest"]],
    )
    bones: list[Bone] = Field(description="Lines to draw between them.")


class IndexVersion(Model):
    """The index that answered."""

    name: str = Field(description="Name of the index.", examples=["cmu-dressed"])
    version: str = Field(description="Hash of its content.", examples=["sha256:9c1f0e7a55d2"])


class RunLengths(Model):
    """A silhouette as COCO's compressed run lengths, which `pycocotools.mask.decode` reads."""

    counts: str = Field(
        description="Outside, inside, ..., by columns.", examples=["l]a76ja000000TZl5"]
    )
    size: list[int] = Field(
        min_length=2,
        max_length=2,
        description="Height and width of the frame, in this order.",
        examples=[[576, 768]],
    )


class SilhouetteSummary(Model):
    """The silhouette from which a pose was estimated."""

    area_px: int = Field(ge=0, description="Pixels of the frame.", examples=[3120])
    segmenter: str = Field(
        description="What segmented it: `network`, `background` (the difference from it), "
        "`grabcut` (colours, with `method=paper`), or the caller's `mask`.",
        examples=["network"],
    )
    truncated: bool = Field(
        description="Whether part of the person is missing: the edge of the frame cuts off the "
        "body, or a nearer person hides it.",
        examples=[False],
    )
    rle: RunLengths | None = Field(description="Its pixels. Null unless `silhouettes=rle`.")
    polygon: list[list[FiniteFloat]] | None = Field(
        description="Its outlines, as COCO's polygon: for each part `[x1, y1, x2, y2, ...]` in "
        "pixels of the frame, through the centres of the outermost pixels; holes are left out. "
        "Null unless requested by `silhouettes=polygon`.",
        examples=[[[401.0, 120.0, 461.0, 120.0, 461.0, 267.0, 401.0, 267.0]]],
    )


class ObservedKeypoint(Model):
    """A keypoint in the photograph."""

    name: str = Field(description="Left and right are the person's own.", examples=["nose"])
    x: _Pixels = Field(description="Pixels of the frame.", examples=[429.0])
    y: _Pixels = Field(description="Pixels of the frame.", examples=[128.5])
    z: Annotated[FiniteFloat, rounding(4)] = Field(
        description="Metres behind the middle of the hips, negative in front of it, as the network "
        "estimates it.",
        examples=[-0.21],
    )
    sd: Annotated[FiniteFloat, Field(ge=0), rounding(3)] = Field(
        description="Standard deviation of `z`, metres: a wrist of 0.2 may well be 20 cm nearer.",
        examples=[0.09],
    )
    score: Score = Field(
        description="Visibility: how certain the network is that the keypoint is inside the frame "
        "and not hidden. Hidden ones are guessed from the rest of the body.",
        examples=[0.81],
    )


class Facing(Model):
    """Whether the person faces the camera, which a silhouette alone cannot show."""

    front_probability: Score = Field(description="That of the front.", examples=[0.91])
    evidence: FacingSource = Field(
        description="The evidence for it: `image`, the keypoints that the photograph shows; "
        "`motion`, the direction in which a tracked person moves; `none`, the silhouette alone, "
        "which cannot show it.",
        examples=["image"],
    )


class Posture(Model):
    """The person's posture, recognised from the photograph or, without one, the silhouette."""

    label: PostureLabel = Field(
        description="The likeliest posture; `unclear` if no posture reaches a probability of one "
        "half.",
        examples=["walking"],
    )
    probability: Score = Field(
        description="Probability that the label is right; for `unclear`, that of the likeliest "
        "posture.",
        examples=[0.88],
    )


class MotionSource(Model):
    """The source of an entry's pose."""

    clip: str = Field(description="Name of the motion capture clip.", examples=["07_01"])
    frame: int = Field(description="Frame of the clip, zero-based.", examples=[34])
    subject: str = Field(description="Name of the avatar.", examples=["f-young-slim"])
    action: str = Field(description="What the clip shows, not the person.", examples=["walk"])
    mirrored: bool = Field(description="Whether left and right were swapped.", examples=[False])


class HypothesisSource(MotionSource):
    """The source of a hypothesis."""

    twin: bool = Field(
        default=False,
        description="Whether it is the twin of the first one, which an outline cannot distinguish: "
        "depths reversed, left and right exchanged. Of a silhouette alone it is among the first "
        "seven, unless another is as near to it as a right hypothesis. It does not count for "
        "`posture` and `facing`; its `camera`, `posture` and distances are those of the first.",
        examples=[False],
    )


class Camera(Model):
    """Position of the virtual camera of an entry."""

    azimuth_deg: Annotated[_Degrees, AfterValidator(lambda degrees: degrees % 360.0)] = Field(
        description="Degrees; 0: it looks the person in the face, 90: it sees the person's left "
        "side.",
        examples=[45.0],
    )
    elevation_deg: _Degrees = Field(description="Height angle of the camera.", examples=[15.0])
    roll_deg: _Degrees = Field(
        description="Degrees; turn about the optical axis, positive turns the picture clockwise. "
        "About 90 or -90 for a person who lies.",
        examples=[0.0],
    )


Flat3D = Annotated[
    list[FiniteFloat | None] | None,
    Field(
        description="`joints_3d` as plain numbers, `[x1, y1, z1, x2, ...]`: three for each "
        "keypoint, null where the entry lacks it. Null as a whole unless `joints=compact`.",
        examples=[[0.0, 0.0, 0.0, 0.01, -0.12, 0.02]],
    ),
]
Flat2D = Annotated[
    list[FiniteFloat | None] | None,
    Field(
        description="`joints_2d` as plain numbers, `[x1, y1, x2, ...]`: two for each keypoint, "
        "null where the entry lacks it. Null as a whole unless `joints=compact`.",
        examples=[[431.2, 190.4, 430.6, 177.9]],
    ),
]


class Hypothesis(Model):
    """One pose that fits the silhouette."""

    rank: int = Field(ge=1, description="1 is the best.", examples=[1])
    entry: int = Field(ge=0, description="Number of the index entry.", examples=[20117])
    distance: FiniteFloat = Field(
        ge=0,
        description="Distance by silhouette and keypoints, which never decreases with the rank. It "
        "starts from `silhouette_distance`; keypoints that support a hypothesis shorten it, and "
        "keypoints that contradict it lengthen it. Without keypoints (`facing.evidence` is "
        "`none`), it is longer the less likely the re-ranking network finds the joints.",
        examples=[0.031],
    )
    silhouette_distance: FiniteFloat = Field(
        ge=0,
        description="Euclidean distance of the two descriptors, regardless of keypoints; "
        "comparable within one index.",
        examples=[0.031],
    )
    reprojection_error_px: FiniteFloat = Field(
        ge=0,
        description="Mean distance, in pixels of the normalised 128x48 frame, between the entry's "
        "skeleton, scaled and placed on the person before it is fitted, and what was observed: "
        "from its joints to the keypoints or, without these, between both outlines.",
        examples=[1.8],
    )
    confidence: Probability = Field(
        description="Calibrated probability that the mean distance of its limb joints (shoulders, "
        "elbows, wrists, hips, knees, ankles) from the person's own, in the image, is under 5 px "
        "of the normalised 128x48 frame and, for an alternative in depth, that its depths are "
        "nearer to the truth than those of the first. It never rises with the rank.",
        examples=[0.87],
    )
    alternative: Literal["depth"] | None = Field(
        default=None,
        description="`depth` if this is the first hypothesis at other depths: the same joints in "
        "the image. Otherwise null.",
        examples=["depth"],
    )
    weight: Probability | None = Field(
        description="Probability that this skeleton is nearer to the truth, in three dimensions, "
        "than the others of the first seven. It never rises with the rank, is 0 from the eighth "
        "on, and null if `facing.evidence` is `none`.",
        examples=[0.22],
    )
    adjusted_mm: FiniteFloat = Field(
        ge=0,
        description="Mean distance, in millimetres, of the joints from those of the entry's own "
        "skeleton (`GET /index/entries/{entry}`), before it was placed in front of the camera.",
        examples=[41.0],
    )
    posture: PostureName = Field(description="By rules (docs/index.md).", examples=["walking"])
    joints_3d: list[Point3D | None] | None = Field(
        description="The entry's skeleton fitted to this person, in metres and the person's size: "
        "interpolated between near entries, moved to the landmarks and placed on the lines of "
        "sight of its pixels. Camera axes (x right, y down, z forward) that follow from "
        "`image.fov_deg`, origin at the pelvis. Null where the entry lacks one, and as a whole "
        "with `joints=compact` or `none`.",
        examples=[[{"x": 0.0, "y": 0.0, "z": 0.0}]],
    )
    joints_2d: list[Point2D | None] | None = Field(
        description="The same in pixels of the frame; null as above.",
        examples=[[{"x": 431.2, "y": 190.4}]],
    )
    joints_3d_flat: Flat3D
    joints_2d_flat: Flat2D
    source: HypothesisSource
    camera: Camera


class Person(Model):
    """One person of the frame."""

    box: Box
    detection_score: Annotated[FiniteFloat, rounding(4)] | None = Field(
        description="The detector's probability that this is a person; for a tracked person, the "
        "highest so far. Null if the caller located the people.",
        examples=[0.93],
    )
    source: Source = Field(
        description="What found the person: the service's detector, the caller's mask or boxes, or "
        "the difference from the background; in camera sessions also `track`: the person is "
        "predicted there from earlier frames.",
        examples=["detector"],
    )
    window_empty: bool = Field(
        description="Whether the photograph shows nobody in a caller's box. The box may be in "
        "another form than `[x, y, width, height]`, or of another frame.",
        examples=[False],
    )
    silhouette: SilhouetteSummary | None = Field(
        description="Null if a caller's box holds no silhouette; there are no hypotheses then."
    )
    observed_keypoints: list[ObservedKeypoint | None] | None = Field(
        description="The 17 COCO keypoints as the photograph shows them, in COCO's order, or all "
        "33 landmarks with `observed=blazepose33`; null for a score below 0.05, and as a whole if "
        "none were read."
    )
    facing: Facing | None = Field(description="Null without a silhouette.")
    posture: Posture | None = Field(description="Null without a silhouette.")
    position: Position | None = Field(
        description="Where the person is, from the first hypothesis. Null if no field of view was "
        "given, and without a silhouette."
    )
    hypotheses: list[Hypothesis] = Field(
        description="Distinct poses, the likeliest first: near entries that agree on a pose count "
        "once. Alternatives in depth (`alternative`) have the joints of the first in the image."
    )


class Timings(Model):
    """Durations in milliseconds."""

    decode: _Milliseconds = Field(description="Decoding the images.", examples=[3.1])
    detect: _Milliseconds = Field(description="Detecting people.", examples=[21.0])
    segment: _Milliseconds = Field(description="Cutting out silhouettes.", examples=[4.4])
    keypoints: _Milliseconds = Field(description="Reading keypoints.", examples=[12.5])
    describe: _Milliseconds = Field(description="Normalising silhouettes.", examples=[0.1])
    search: _Milliseconds = Field(description="Moments, nearest, distinct poses.", examples=[0.4])
    total: _Milliseconds = Field(description="All work, without waiting.", examples=[29.6])


class PoseResponse(Model):
    """The people of a frame, each with the poses that fit."""

    image: Image
    index: IndexVersion
    keypoints: Keypoints
    persons: list[Person] = Field(description="Ordered left to right; empty if there are none.")
    timings_ms: Timings


class DescriptorSummary(Model):
    """The descriptor by which silhouettes are compared."""

    name: str = Field(description="Name of the descriptor.", examples=["krawtchouk-discriminant"])
    dimension: int = Field(description="Values in a vector.", examples=[48])


class ServiceVersion(Model):
    """The build of the service that runs."""

    version: str = Field(description="Version of the service.", examples=["1.0.0"])
    revision: str = Field(description="Git revision it was built from.", examples=["a86e38b"])
    detector: Literal["network", "hog"] = Field(
        description="Person detector of requests that name no method; `hog` with "
        "`POSE_METHOD=paper`.",
        examples=["network"],
    )


class IndexResponse(IndexVersion):
    """The content of the index and how it was built."""

    entries: int = Field(description="Simulated silhouettes.", examples=[40000])
    descriptor: DescriptorSummary
    joints: list[str] = Field(description="The native keypoints.", examples=[["pelvis", "spine"]])
    bones: list[Bone] = Field(description="Lines between the native keypoints.")
    actions: list[str] = Field(description="Labels of the motions.", examples=[["walk", "jump"]])
    subjects: list[str] = Field(description="Names of the avatars.", examples=[["f-young-slim"]])
    parameters: dict[str, Any] = Field(
        description="How the index was built; its keys belong to the builder.",
        examples=[{"seed": 1}],
    )
    attribution: str = Field(
        description="Whose data it was built from, to be shown with results.",
        examples=["The data used in this project was obtained from mocap.cs.cmu.edu."],
    )
    service: ServiceVersion


class EntryResponse(Model):
    """One entry of the index: a simulated silhouette and its skeleton."""

    entry: int = Field(ge=0, description="Number of the entry.", examples=[20117])
    source: MotionSource
    camera: Camera
    keypoints: Keypoints
    joints_3d: list[Point3D | None] = Field(
        description="Metres; camera axes (x right, y down, z forward), origin at the pelvis. "
        "Null where the entry lacks a keypoint."
    )
    joints_2d: list[Point2D | None] = Field(description="Pixels of 128x48. Null as above.")


class DeepstackUpload(Model):
    """An image, as DeepStack's clients send it."""

    image: bytes = Field(description=FRAME)
    min_confidence: Probability = Field(
        default=0.4,
        description="Detections below this score are left out; 0.4 if it is missing.",
    )
    api_key: str | None = Field(default=None, description="As in the headers, if one is needed.")


class DeepstackPrediction(Model):
    """A person, in DeepStack's form."""

    label: Literal["person"] = Field(description="Always `person`.", examples=["person"])
    confidence: Probability = Field(description="Score of the detector.", examples=[0.93])
    x_min: int = Field(description="Left edge, pixels of the image.", examples=[401])
    y_min: int = Field(description="Top edge, pixels of the image.", examples=[120])
    x_max: int = Field(description="Right edge, pixels of the image.", examples=[462])
    y_max: int = Field(description="Bottom edge, pixels of the image.", examples=[268])


# Frigate's plugin copies predictions into an array of as many rows, without a check.
MAX_PREDICTIONS = 20


class DeepstackResponse(Model):
    """The people of an image, in DeepStack's form."""

    success: bool = Field(description="Always true; an error has another status.", examples=[True])
    predictions: list[DeepstackPrediction] = Field(
        max_length=MAX_PREDICTIONS, description="The most certain first."
    )
    duration: FiniteFloat = Field(ge=0, description="Seconds.", examples=[0.042])


class Health(Model):
    """The service works; otherwise the reply is a problem."""

    status: Literal["ok"] = Field(default="ok", description="Always `ok`.", examples=["ok"])
