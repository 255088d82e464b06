"""The service, and the library behind it: photographs and cameras in, people with poses out.

What programs may import from here is in ``__all__``; docs/library.md shows how. It is loaded on
first use, so that programs which need little of it start fast.
"""

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING

# Type checkers see neither `__getattr__` nor a computed `__all__`; `as` exports the names to them.
if TYPE_CHECKING:
    from app.camera import CameraSession as CameraSession
    from app.estimation.upload import Upload as Upload
    from app.estimation.upload import UploadError as UploadError
    from app.photograph import Estimator as Estimator
    from app.photograph import load_estimator as load_estimator
    from app.settings import Settings as Settings
    from app.tracking.zones import Zone as Zone
    from app.vision.geometry import Box as Box
    from app.vision.optics import Optics as Optics

_PLACES = {
    "Box": "app.vision.geometry",
    "CameraSession": "app.camera",
    "Estimator": "app.photograph",
    "Optics": "app.vision.optics",
    "Settings": "app.settings",
    "Upload": "app.estimation.upload",
    "UploadError": "app.estimation.upload",
    "Zone": "app.tracking.zones",
    "load_estimator": "app.photograph",
}

__all__ = ["VERSION", *_PLACES]

try:
    VERSION = version("silhouette-pose")
except PackageNotFoundError:  # The checkout was never installed.
    VERSION = "0.0.0"


def __getattr__(name: str) -> object:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_PLACES[name]), name)
