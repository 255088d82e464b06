"""The service, and the library behind it: photographs and cameras in, people with poses out.

What programs may import from here is in ``__all__``; docs/library.md shows how. It is loaded on
first use, so that programs which need little of it start fast.
"""

import sys
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING

# Type checkers see neither `__getattr__` nor a computed `__all__`; `as` exports the names to them.
if TYPE_CHECKING:
    from app.camera import CameraSession as CameraSession
    from app.camera import LateFrameError as LateFrameError
    from app.estimation.upload import Upload as Upload
    from app.estimation.upload import UploadError as UploadError
    from app.photograph import Estimator as Estimator
    from app.photograph import MethodError as MethodError
    from app.photograph import load_estimator as load_estimator
    from app.settings import Settings as Settings
    from app.tracking.zones import Zone as Zone
    from app.vision.geometry import Box as Box
    from app.vision.optics import Optics as Optics
    from descriptor.silhouette import normalise as normalise
    from index.artefact import load_index as load_index
    from index.silhouette_matching import match_silhouette as match_silhouette
    from index.skeleton import POINT_NAMES as POINT_NAMES

_PLACES = {
    "Box": "app.vision.geometry",
    "CameraSession": "app.camera",
    "Estimator": "app.photograph",
    "LateFrameError": "app.camera",
    "MethodError": "app.photograph",
    "Optics": "app.vision.optics",
    "POINT_NAMES": "index.skeleton",
    "Settings": "app.settings",
    "Upload": "app.estimation.upload",
    "UploadError": "app.estimation.upload",
    "Zone": "app.tracking.zones",
    "load_estimator": "app.photograph",
    "load_index": "index.artefact",
    "match_silhouette": "index.silhouette_matching",
    "normalise": "descriptor.silhouette",
}

__all__ = ["VERSION", *_PLACES]

try:
    VERSION = version("silhouette-pose")
except PackageNotFoundError:  # The checkout was never installed.
    VERSION = "0.0.0"


def __getattr__(name: str) -> object:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value: object = getattr(import_module(_PLACES[name]), name)
    # In tracebacks, what programs import has the name by which they do, as app.UploadError.
    for public, place in _PLACES.items():
        if place.startswith("app.") and place in sys.modules:
            getattr(sys.modules[place], public).__module__ = __name__
    return value
