"""What an operator says about a camera: zones, optics, events. Also read by the bridge.

It is the body of ``PUT /cameras/{camera_id}``, and an entry of files of cameras.
"""

import math
from typing import Annotated, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    FiniteFloat,
    StringConstraints,
    field_validator,
    model_validator,
)

from app.messages import expected_name, shortened

# A name must not be "." or "..", which have another meaning in a path.
CAMERA_PATTERN = "^[A-Za-z0-9_-][A-Za-z0-9._-]{0,63}$"
CameraId = Annotated[str, StringConstraints(pattern=CAMERA_PATTERN)]

EventName = Literal[
    "entered", "left", "zone_entered", "zone_left", "lying", "fell", "arms_raised", "obstructed"
]
EVENT_NAMES: tuple[EventName, ...] = get_args(EventName)

ZoneKind = Literal["rest", "watch"]
"""``rest``: a bed or sofa, where lying is not an event; ``watch``: any other place of interest."""

MAX_NAME_CHARACTERS = 64
MAX_ZONES, MAX_CORNERS = 32, 64

FieldOfView = Annotated[
    FiniteFloat,
    Field(
        ge=10,
        le=170,
        description="Horizontal field of view of the camera, degrees. Without it, 60 degrees are "
        "assumed across the longer side of the frame. In a camera session, a frame's own value "
        "wins over that of `PUT /cameras/{camera_id}`.",
        examples=[90.0],
    ),
]
PixelAspect = Annotated[
    FiniteFloat,
    Field(
        ge=0.25,
        le=4,
        description="Width over height of a pixel; 2 for a camera that sends 960x1080 for "
        "1920x1080. 1 without it, and of a video what its file says. The reply is in pixels of the "
        "frame that was sent. In a camera session, a frame's own value wins.",
        examples=[1.0],
    ),
]
Roll = Annotated[
    FiniteFloat,
    Field(
        ge=-360,
        le=360,
        multiple_of=90,
        description="Clockwise rotation of the camera about its line of sight, degrees, a multiple "
        "of 90; 0 without it. 90 for a camera whose upper side points to the right, so that people "
        "have their heads at the left of its picture. Frames are turned upright first; the reply "
        "is in pixels and axes of the frame that was sent. In a session, a frame's own value wins.",
        examples=[0.0],
    ),
]


def has_area(polygon: NDArray[np.float64]) -> bool:
    """Whether the corners ``(P, 2)`` are more than half a pixel away from a common line."""
    spread = np.linalg.svd(polygon - polygon.mean(axis=0), compute_uv=False)[-1]
    return bool(spread / math.sqrt(len(polygon)) > 0.5)


class UnknownNameError(ValueError):
    """Something was given a name that is none of the known ones."""

    def __init__(self, name: str, sentence: str) -> None:
        super().__init__(sentence)
        self.name = name


class Given(BaseModel):
    """A part of a configuration; an unknown field is refused with the names of those that exist."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    @model_validator(mode="before")
    @classmethod
    def _check_names(cls, given: object) -> object:
        # Pydantic would refuse unknown names too, but not list the known ones.
        for name in given if isinstance(given, dict) else ():
            if name not in cls.model_fields:
                got = f", got {shortened(name)}"
                sentence = expected_name(name, cls.model_fields, "fields", got)
                raise UnknownNameError(name, sentence)
        return given


class Zone(Given):
    """A region of a camera's image."""

    name: str = Field(
        min_length=1,
        max_length=MAX_NAME_CHARACTERS,
        description="Unique for the camera.",
        examples=["bed"],
    )
    kind: ZoneKind = Field(
        description="`rest`: a bed or a sofa, where lying is normal: neither `lying` nor `fell` "
        "begins there; `watch`: any other region to name with persons and events.",
        examples=["rest"],
    )
    polygon: list[
        Annotated[
            list[Annotated[FiniteFloat, Field(strict=True)]], Field(min_length=2, max_length=2)
        ]
    ] = Field(
        min_length=3,
        max_length=MAX_CORNERS,
        description="Corners `[x, y]` in order, in pixels of the frame. The polygon may reach "
        "beyond the frame and cross itself; what it then surrounds twice lies outside of it.",
        examples=[[[210, 300], [420, 290], [440, 470], [190, 470]]],
    )

    @model_validator(mode="before")
    @classmethod
    def _choose_kind(cls, given: object) -> object:
        # A missing one is refused like a wrong one: with the kinds that there are.
        return {"kind": None, **given} if isinstance(given, dict) else given

    @field_validator("name")
    @classmethod
    def _is_printable(cls, name: str) -> str:
        if not name.isprintable():
            raise ValueError(f"expected a name of printable characters, got {name!r}")
        return name

    @field_validator("polygon")
    @classmethod
    def _holds_something(cls, polygon: list[list[float]]) -> list[list[float]]:
        if not has_area(np.array(polygon)):
            got = "all of them within a pixel" if np.ptp(polygon, axis=0).max() <= 1 else "a line"
            raise ValueError(f"expected corners around an area, in pixels of the frame, got {got}")
        return polygon


class CameraConfiguration(Given):
    """The configuration of a camera."""

    zones: list[Zone] = Field([], max_length=MAX_ZONES, description="All zones of the camera.")
    fov_deg: Annotated[FieldOfView, Field(strict=True)] | None = Field(
        None, description="Horizontal field of view, degrees, for frames that are sent without one."
    )
    pixel_aspect: Annotated[PixelAspect, Field(strict=True)] | None = Field(
        None, description="Width over height of a pixel, for frames that are sent without one."
    )
    roll_deg: Annotated[Roll, Field(strict=True)] | None = Field(
        None,
        description="Clockwise rotation of the camera about its line of sight, degrees, for frames "
        "that are sent without one.",
    )
    events: list[EventName] | None = Field(
        None, description="The events that the camera raises; by default, or with null, all."
    )

    def raises(self, event: EventName) -> bool:
        """Whether the camera raises events of this name."""
        return self.events is None or event in self.events

    @field_validator("zones")
    @classmethod
    def _named_once(cls, zones: list[Zone]) -> list[Zone]:
        names = [zone.name for zone in zones]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"expected zones of different names, got {name!r} twice")
        return zones
