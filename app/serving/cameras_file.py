"""The configuration of cameras in a file, which survives a restart."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import StringConstraints, TypeAdapter, ValidationError

from app.api.replies import settings_from
from app.api.tracking_schemas import CameraConfiguration
from app.http.identity import CAMERA_PATTERN
from app.messages import located
from app.settings import SettingsError
from app.tracking.sessions import CameraSettings

_CAMERAS = TypeAdapter(
    dict[Annotated[str, StringConstraints(pattern=CAMERA_PATTERN)], CameraConfiguration]
)


def read_cameras(path: Path | None) -> dict[str, CameraSettings]:
    """Read the settings of cameras by their names; none without a file.

    Parameters
    ----------
    path : Path or None
        A JSON object: for each name, the body of ``PUT /cameras/{camera_id}``.

    Raises
    ------
    SettingsError
        If the file cannot be read or does not fit; the message is one sentence.
    """
    if path is None:
        return {}
    try:
        cameras = _CAMERAS.validate_json(path.read_text(errors="replace"))
    except OSError as error:
        reason = error.strerror or type(error).__name__
        sentence = f"expected a file of cameras, got {path}: {reason}"
    except ValidationError as error:
        first = error.errors()[0]
        place, problem = located(first)
        sentence = f"{path}: {place}: {problem}" if place else f"{path}: {problem}"
    else:
        return {name: settings_from(camera) for name, camera in cameras.items()}
    raise SettingsError(f"POSE_CAMERAS_FILE: {sentence}")
