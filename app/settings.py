"""The settings, read from the environment (``POSE_...``, ``HOST``, ``PORT``, ``WORKERS``)."""

import os
import re
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, SecretStr, ValidationError, ValidationInfo, field_validator
from pydantic.fields import FieldInfo
from pydantic_settings import BaseSettings, NoDecode, SettingsConfigDict

from app.messages import expected_and_got, shortened, suggestion
from app.scheduling.process import available_cores
from index import DEFAULT_PATH

PREFIX = "POSE_"
_ORIGIN = re.compile(r"[a-z][a-z0-9+.-]*://[^/?#\s]+|\*")
# Kubernetes sets such variables in all containers of a namespace with a service called "pose".
_KUBERNETES = re.compile(r"POSE_(SERVICE_(HOST|PORT)(_\w+)?|PORT_\d+_(TCP|UDP)(_\w+)?)")

Method = Literal["networks", "paper"]
"""By networks, which also read landmarks, or as in the paper, by HOG and silhouettes alone."""

Segmenter = Literal["network", "grabcut"]
"""What cuts people out of a frame where neither a mask nor a background does."""

_Seconds = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class SettingsError(ValueError):
    """An environment variable is invalid; the message is one sentence that begins with its name."""


class Settings(BaseSettings):
    """Settings of the service; the defaults suit one machine and a few cameras."""

    model_config = SettingsConfigDict(env_prefix=PREFIX, env_ignore_empty=True, frozen=True)

    host: str = Field(
        default="127.0.0.1",
        validation_alias="HOST",
        description="Address to listen on; `0.0.0.0` for all addresses of the "
        "machine, `::` also for those of IPv6.",
    )
    port: int = Field(
        default=8000, ge=1, le=65535, validation_alias="PORT", description="Port to listen on."
    )
    workers: int = Field(
        default=1,
        ge=1,
        validation_alias="WORKERS",
        description="Number of server processes; see below.",
    )

    index: Path = Field(
        default=DEFAULT_PATH,
        description="Folder of the index artefact; with `POSE_MILVUS`, it may hold several.",
    )
    milvus: str | None = Field(
        default=None,
        description="Milvus that searches the index, `http://host:19530`; see "
        "[an index in Milvus](#an-index-in-milvus).",
    )
    method: Method = Field(
        default="networks",
        description="`networks`, or `paper`: by default, requests are answered by the paper's "
        "method, and no network is loaded.",
    )
    min_person_px: int | None = Field(
        default=None,
        ge=16,
        description="Height in pixels of the smallest person to look for; smaller is slower. By "
        "default a twelfth of the frame's height.",
    )

    max_upload_bytes: int = Field(
        default=16 * 1024**2, ge=1024, description="Largest request, in bytes."
    )
    max_pixels: int = Field(
        default=12_500_000,
        ge=1,
        description="Width times height of the largest image; checked before decoding.",
    )
    max_persons: int = Field(default=50, ge=1, le=100, description="Most people in a frame.")
    max_requests: int = Field(
        default=32, ge=1, description="Most uploads open at once, with those still being received."
    )
    concurrency: int = Field(
        default_factory=available_cores,
        ge=1,
        description="Frames processed at once; a frame with several people also uses idle threads.",
    )
    max_wait_s: _Seconds = Field(
        default=2.0,
        description="How long an uploaded frame may wait for a thread. A frame expected to wait "
        "longer than three quarters of this is refused at once.",
    )
    request_timeout_s: _Seconds = Field(
        default=10.0, description="Longest time from upload to reply."
    )
    upload_timeout_s: _Seconds = Field(
        default=30.0, description="Longest upload; a slower one gets a 408."
    )

    max_cameras: int = Field(
        default=64,
        ge=0,
        validate_default=True,
        description="Most camera sessions; the least recently used one is dropped. 0 turns "
        "sessions off.",
    )
    cameras_file: Path | None = Field(
        default=None,
        description="JSON file with zones and optics of cameras, read at the start; see "
        "[zones](tracking.md#zones).",
    )
    camera_idle_s: _Seconds = Field(
        default=300.0,
        description="Seconds without a frame after which a camera session is dropped.",
    )
    camera_memory_mb: int = Field(
        default=256,
        ge=1,
        description="Memory of all sessions; the least recently used one is dropped.",
    )

    max_sequences: int = Field(
        default=2,
        ge=1,
        description="Most videos at once, of one caller one less; one more gets a 503.",
    )
    max_video_bytes: int = Field(
        default=64 * 1024**2,
        ge=1024,
        description="Largest request with a video; it is kept in memory.",
    )
    video_upload_timeout_s: _Seconds = Field(
        default=120.0, description="Longest upload of a video."
    )
    max_sequence_frames: int = Field(
        default=5000, ge=1, description="Most frames of a video that are processed."
    )
    sequence_timeout_s: _Seconds = Field(
        default=900.0,
        description="Longest time from a video's upload to the last line of the reply.",
    )

    api_keys: Annotated[tuple[SecretStr, ...], NoDecode] = Field(
        default=(), description="Comma-separated keys; without any, no key is required."
    )
    cors_origins: Annotated[tuple[str, ...], NoDecode] = Field(
        default=(), description="Origins, comma-separated, whose pages may call the service."
    )

    log_level: Literal["debug", "info", "warning", "error"] = Field(
        default="info", description="`debug`, `info`, `warning` or `error`."
    )
    revision: str = Field(default="unknown", description="Git revision of this build.")

    @field_validator("milvus")
    @classmethod
    def _check_milvus_package(cls, uri: str | None) -> str | None:
        if uri is not None and find_spec("pymilvus") is None:
            raise ValueError("expected the extra milvus to be installed; pymilvus is missing")
        return uri

    @field_validator("api_keys", "cors_origins", mode="before")
    @classmethod
    def _split(cls, value: object) -> object:
        if not isinstance(value, str):
            return value
        parts = tuple(part.strip() for part in value.split(","))
        # An empty key would open a service that was meant to be locked.
        if not all(parts):
            raise ValueError("expected values separated by commas, got an empty one")
        return parts

    @field_validator("max_cameras")
    @classmethod
    def _check_sessions(cls, sessions: int, info: ValidationInfo) -> int:
        workers = info.data.get("workers", 1)
        if sessions and workers > 1:
            reason = f"WORKERS={workers}, since each process would know a part of every camera"
            raise ValueError(f"expected 0 with {reason}, got {sessions}")
        return sessions

    @field_validator("cors_origins")
    @classmethod
    def _check_origins(cls, origins: tuple[str, ...]) -> tuple[str, ...]:
        for origin in origins:
            if not _ORIGIN.fullmatch(origin):
                such = "origins of scheme and host such as https://yard.example"
                raise ValueError(f"expected {such}, got {shortened(origin)}")
        return origins


def variable(name: str, field: FieldInfo) -> str:
    alias = field.validation_alias
    return alias if isinstance(alias, str) else f"{PREFIX}{name.upper()}"


VARIABLES = tuple(variable(name, field) for name, field in Settings.model_fields.items())


def read_settings() -> Settings:
    """Read the settings from the environment.

    Raises SettingsError if a value is invalid, or a variable looks like a setting but is none.
    """
    _refuse_unknown(os.environ)
    try:
        return Settings()
    except ValidationError as error:
        first = error.errors()[0]
        place = str(first["loc"][0]).upper()
        name = place if place in VARIABLES else f"{PREFIX}{place}"
        sentence = f"{_spelling(name)}: {expected_and_got(first)}"
    # The error is raised outside the handler, whose own error holds the values, secrets included.
    raise SettingsError(sentence)


def _refuse_unknown(environment: Mapping[str, str]) -> None:
    known = {name.removeprefix(PREFIX): name for name in VARIABLES}
    for spelling, value in environment.items():
        name = spelling.upper()
        is_kubernetes = _KUBERNETES.fullmatch(name) or value.startswith(("tcp://", "udp://"))
        if name.startswith(PREFIX) and name not in VARIABLES and not is_kubernetes:
            hint = suggestion(name.removeprefix(PREFIX), known) or ", which has none of this name"
            expected = f"{spelling}: expected one of the settings in docs/running.md"
            raise SettingsError(expected + hint)


def _spelling(name: str) -> str:
    """Return a variable's name in the case in which it was set."""
    return next((spelling for spelling in os.environ if spelling.upper() == name), name)
