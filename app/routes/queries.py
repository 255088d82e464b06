"""Query parameters of the routes; nothing that a client sends is silently ignored."""

from collections import Counter
from collections.abc import Collection, Iterable
from dataclasses import replace
from typing import Annotated, Any

from fastapi import Depends, Request
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, FiniteFloat, model_validator

from app.api import schemas
from app.api.replies import ReplyForm
from app.api.tracking_schemas import LATEST_TIMESTAMP_S
from app.configuration import FieldOfView, PixelAspect, Roll
from app.estimation.results import Evidence
from app.estimation.upload import Upload
from app.http.errors import invalid
from app.messages import NUMBER, WHOLE_NUMBER, expected_name
from app.photograph import Estimator, MethodError
from app.settings import Method, Segmenter
from app.vision.optics import Optics
from index.matching import DEFAULT_HYPOTHESES
from index.skeleton import KEYPOINT_SETS

_LATEST_MS = round(1000 * LATEST_TIMESTAMP_S)


def _check_seconds(timestamp: float) -> float:
    if timestamp > LATEST_TIMESTAMP_S:
        most = f"seconds, at most {LATEST_TIMESTAMP_S:.0f}"
        raise ValueError(f"expected {most}, got {timestamp:.15g}; divide milliseconds by 1000")
    return timestamp


Timestamp = Annotated[
    FiniteFloat,
    Field(ge=0, json_schema_extra={"maximum": LATEST_TIMESTAMP_S}),
    NUMBER,
    AfterValidator(_check_seconds),
]

_HypothesisCount = Annotated[
    int,
    Field(ge=1, le=50, description="Hypotheses per person, 1 to 50.", examples=[7]),
    WHOLE_NUMBER,
]
_KeypointSet = Annotated[
    schemas.KeypointSetName,
    Field(
        description="`native` or `cmu19`: the 19 joints of the index; `coco17`: the 17 COCO "
        "keypoints; `h36m17`: the 17 of Human3.6M.",
        examples=["native"],
    ),
]
_Evidence = Annotated[
    Evidence,
    Field(
        description="`photograph`: the silhouette and the keypoints that the photograph shows, and "
        "with them which way a person faces; `silhouette`: the silhouette alone, which is fastest.",
        examples=["photograph"],
    ),
]
_Method = Annotated[
    Method | None,
    Field(
        description="`networks`: networks find people and read keypoints; `paper`: the method of "
        "Atrevi et al. (2016), people by HOG, silhouettes by GrabCut, and the nearest entries, "
        "with `evidence=silhouette` alone. By default what `POSE_METHOD` says.",
        examples=["networks"],
    ),
]
_Segmenter = Annotated[
    Segmenter | None,
    Field(
        description="What cuts people out where neither a mask nor a background does: `network`, "
        "or, with `method=paper`, `grabcut`, which is its default.",
        examples=["network"],
    ),
]
_Joints = Annotated[
    schemas.JointForm,
    Field(
        description="How joints are written: `full`, an object for each; `compact`, plain numbers "
        "in `joints_3d_flat` and `joints_2d_flat`; `none`, not at all. In replies about cameras "
        "and videos, `none` also leaves out hypotheses and poses, which takes less time.",
        examples=["full"],
    ),
]


def check_names(given: Iterable[str], known: Collection[str], kind: str) -> None:
    """Raise a 422 for the first name that is not known, and suggest a similar one."""
    for name in given:
        if name not in known:
            short = name[:60]
            raise invalid(short, expected_name(short, known, kind))


def check_given_once(given: Iterable[str], unit: str) -> None:
    """Raise a 422 for the first name that occurs several times."""
    for name, count in Counter(given).items():
        if count > 1:
            raise invalid(name, f"expected one {unit}, got {count}")


class _Query(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    @model_validator(mode="before")
    @classmethod
    def _check_names(cls, given: dict[str, Any]) -> dict[str, Any]:
        # Pydantic would refuse unknown names too, but not list the known ones.
        check_names(given, sorted(cls.model_fields), "query parameters")
        return given


class EntryQuery(_Query):
    """Query parameters of an index entry."""

    keypoints: _KeypointSet = "native"


class _CameraQuery(_Query):
    """Query parameters of the camera that took a frame."""

    fov_deg: Annotated[FieldOfView | None, NUMBER] = None
    pixel_aspect: Annotated[PixelAspect | None, NUMBER] = None
    roll_deg: Annotated[Roll | None, NUMBER] = None

    @property
    def optics(self) -> Optics:
        return Optics(self.fov_deg, self.pixel_aspect, self.roll_deg)

    def of(self, upload: Upload) -> Upload:
        return replace(upload, optics=self.optics)


class OverlayQuery(_CameraQuery):
    """Query parameters of a picture of poses."""

    keypoints: _KeypointSet = "native"
    evidence: _Evidence = "photograph"
    method: _Method = None
    segmenter: _Segmenter = None


class PoseQuery(OverlayQuery):
    """Query parameters of the poses in a frame."""

    n: _HypothesisCount = DEFAULT_HYPOTHESES
    silhouettes: Annotated[
        schemas.SilhouetteForm,
        Field(
            description="Whether the reply includes silhouettes, and in which of COCO's forms: "
            "`rle`, every pixel; `polygon`, the outlines.",
            examples=["rle"],
        ),
    ] = "none"
    joints: _Joints = "full"
    observed: Annotated[
        schemas.ObservedSetName,
        Field(
            description="Which keypoints `observed_keypoints` lists: `coco17`, or `blazepose33`, "
            "all 33 landmarks that are read.",
            examples=["coco17"],
        ),
    ] = "coco17"

    @property
    def form(self) -> ReplyForm:
        chosen = KEYPOINT_SETS[self.keypoints]
        return ReplyForm(chosen, self.silhouettes, self.joints, self.observed)


class SilhouetteQuery(_Query):
    """Query parameters of a label image."""

    method: _Method = None
    segmenter: _Segmenter = None

    view: bool = Field(
        default=False,
        description="Whether people are in the colours of `/pose/overlay`, for viewing, "
        "instead of labels.",
        examples=[True],
    )


class TrackQuery(PoseQuery):
    """Query parameters of a camera's frame."""

    timestamp: Annotated[
        Timestamp | None,
        Field(
            description="Like the form field of this name, if the photograph is the body itself.",
            examples=[12.4],
        ),
    ] = None
    timestamp_ms: Annotated[
        Annotated[int, Field(ge=0, le=_LATEST_MS, json_schema_extra={"format": "int64"})] | None,
        Field(
            description="The timestamp in milliseconds instead, for clients that write fractions "
            "with 32 bits.",
            examples=[1795880000250],
        ),
        WHOLE_NUMBER,
    ] = None


class SequenceQuery(OverlayQuery):
    """Query parameters of a video."""

    max_frames: Annotated[
        int | None,
        Field(
            ge=1,
            description="Most frames that are processed; by default, and at most, as many as the "
            "service allows.",
            examples=[500],
        ),
        WHOLE_NUMBER,
    ] = None
    n: _HypothesisCount = DEFAULT_HYPOTHESES
    joints: _Joints = "full"
    stride: Annotated[
        int,
        Field(ge=1, le=1000, description="Only every n-th frame is processed.", examples=[2]),
        WHOLE_NUMBER,
    ] = 1

    @property
    def form(self) -> ReplyForm:
        return ReplyForm(KEYPOINT_SETS[self.keypoints], joints=self.joints)


def estimator_for(estimator: Estimator, query: OverlayQuery | SilhouetteQuery) -> Estimator:
    """Return the estimator of the method that a query asks for; a 422 if there is none."""
    try:
        chosen = estimator.by(query.method, query.segmenter)
    except MethodError as error:
        raise invalid(error.field, str(error)) from None
    given = getattr(query, "evidence", None) if "evidence" in query.model_fields_set else None
    if given is not None and given != chosen.evidence(given):
        raise invalid("evidence", f"expected silhouette with the paper's method, got {given}")
    return chosen


def hypotheses_of(query: TrackQuery | SequenceQuery) -> int:
    """Hypotheses of each tracked person; none if no joints are written."""
    return 0 if query.joints == "none" else query.n


async def _given_once(request: Request) -> None:
    # A model cannot check this: FastAPI gives it only the last value of each name.
    check_given_once((name for name, _ in request.query_params.multi_items()), "value")


GivenOnce = Depends(_given_once)
"""Refuses query parameters that are given several times."""


async def _no_query(request: Request) -> None:
    check_names(request.query_params, (), "query parameters")


NoQuery = Depends(_no_query)
"""Refuses all query parameters."""
