"""Everything an operator can set, read from the environment (``POSE_...``)."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

from pydantic import Field, SecretStr, field_validator
from pydantic_settings import BaseSettings, NoDecode, SettingsConfigDict

from index.store import DEFAULT_PATH

DEFAULT_MODELS = Path(__file__).resolve().parent.parent / "models"


def _cores() -> int:
    """Cores this process may use: a container's share, not the machine's."""
    return len(os.sched_getaffinity(0))


class Settings(BaseSettings):
    """Settings of the service; each default suits one machine beside a few cameras."""

    model_config = SettingsConfigDict(env_prefix="POSE_", frozen=True)

    index: Path = Field(default=DEFAULT_PATH, description="Folder of the index artefact.")
    models: Path = Field(
        default=DEFAULT_MODELS,
        description="Folder of the segmentation networks (TFLite); where one is missing, "
        "GrabCut serves.",
    )
    min_person_px: int = Field(
        default=50,
        ge=16,
        description="Height of the smallest person looked for; smaller is slower.",
    )

    max_upload_bytes: int = Field(default=16 * 1024**2, ge=1024, description="Of a whole request.")
    max_pixels: int = Field(
        default=12_500_000,
        ge=1,
        description="Width times height of one image; read in its header, before decoding.",
    )
    max_persons: int = Field(default=50, ge=1, le=100, description="In one frame.")
    max_requests: int = Field(
        default=64, ge=1, description="Uploads open at once, those still being received included."
    )
    concurrency: int = Field(
        default_factory=_cores,
        ge=1,
        description="Frames worked on at once: a thread each, and two beside it for photographs.",
    )
    queue_length: int = Field(default=16, ge=0, description="Frames that may wait for a thread.")
    request_timeout_s: float = Field(
        default=10.0, gt=0, description="From the end of the upload to the answer."
    )
    upload_timeout_s: float = Field(
        default=30.0, gt=0, description="A slower client is sent away with 408."
    )

    api_keys: Annotated[tuple[SecretStr, ...], NoDecode] = Field(
        default=(), description="Comma-separated; where there are none, nobody is asked for one."
    )
    cors_origins: Annotated[tuple[str, ...], NoDecode] = Field(
        default=(), description="Comma-separated origins whose pages may call the service."
    )

    log_level: str = Field(default="info", pattern="^(debug|info|warning|error)$")
    revision: str = Field(default="unknown", description="Git revision of this build.")

    @field_validator("api_keys", "cors_origins", mode="before")
    @classmethod
    def _split(cls, value: object) -> object:
        if isinstance(value, str):
            return tuple(part.strip() for part in value.split(",") if part.strip())
        return value
