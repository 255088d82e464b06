"""The table of requests, in the order in which they are sent."""

import json
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np

from tests.golden import pictures
from tests.golden.pictures import EMPTY_YARD, STREET, STREET_MASK, YARD, png


@dataclass(frozen=True)
class Request:
    """A request, and how exactly its answer is known.

    Parameters
    ----------
    name : str
        Also that of the file of its answer.
    method, path : str
    params : mapping of str
        Of the query.
    exact : bool
        Whether the answer is the same to the last digit on every processor. Networks that read
        photographs round differently, hence their answers are compared to a tolerance.
    service : str
        ``open``; or ``locked``, which asks for a key and never gets to loading its index.
    kept : bool
        Whether the answer is stored; frames in between only lead up to others.
    options : dict
        Of the client: ``files``, ``data``, ``json``, ``content`` or ``headers``.
    """

    name: str
    method: str
    path: str
    params: Mapping[str, Any] = field(default_factory=dict)
    exact: bool = True
    service: str = "open"
    kept: bool = True
    options: dict[str, Any] = field(default_factory=dict)

    @property
    def camera(self) -> str:
        """The camera, of which the answer to one request depends on the requests before it."""
        _, place, *names = self.path.split("/")
        return names[0] if place == "cameras" else self.name


@cache
def requests() -> tuple[Request, ...]:
    """Return all of them; drawn when they are first needed."""
    return (
        *_silhouettes(),
        *_photographs(),
        *_session("masks", exact=True),
        *_session("photographs", exact=False),
        *_masks("falls", pictures.falls(), kept=range(9, 40, 10), zones=_BED),
        *_masks("crossing", pictures.crossing(), kept=range(0, 25, 3)),
        *_masks("greeting", pictures.greeting(), kept=(14, 24, 29, 44)),
        *_named_by_caller(),
        *_wide_angle(),
        *_video(),
        *_index(),
        *_errors(),
    )


def kept_requests() -> list[Request]:
    """Return those whose answers are stored."""
    return [request for request in requests() if request.kept]


def _post(name: str, files: dict[str, bytes], path: str = "/pose", **kwargs: Any) -> Request:
    exact, kept = kwargs.pop("exact", True), kwargs.pop("kept", True)
    options = {"files": files, "data": kwargs.pop("data", {})}
    return Request(name, "POST", path, kwargs, exact=exact, kept=kept, options=options)


def _silhouettes() -> Iterator[Request]:
    """Masks: what counts is the silhouette alone."""
    alone = {"evidence": "silhouette"}
    street = {"mask": STREET_MASK}
    standing, crowd = pictures.standing(), pictures.crowd()
    yield _post("mask", street, n=2, **alone)
    yield _post("mask-with-frame", {"frame": STREET, **street}, n=1, **alone)
    yield _post("mask-rle", street, n=1, joints="none", silhouettes="rle", **alone)
    yield _post("mask-polygon", street, n=1, joints="none", silhouettes="polygon", **alone)
    yield _post("mask-coco17", street, n=1, keypoints="coco17", **alone)
    yield _post("mask-h36m17", street, n=1, keypoints="h36m17", joints="compact", **alone)
    yield _post("mask-many", {"mask": png(standing)}, n=12, joints="none", **alone)
    # 255 is one person too.
    yield _post("drawn-standing", {"mask": png(255 * standing)}, n=3, **alone)
    yield _post("drawn-arms-raised", {"mask": png(pictures.arms_raised())}, n=3, **alone)
    yield _post("drawn-lying", {"mask": png(pictures.lying())}, n=3, joints="compact", **alone)
    yield _post(
        "drawn-standing-with-frame",
        {"frame": png(pictures.frame_of(standing)), "mask": png(standing)},
        n=1,
        **alone,
    )
    yield _post("drawn-crowd", {"mask": png(crowd)}, n=1, silhouettes="rle", **alone)
    yield _post("drawn-nobody", {"mask": png(np.zeros_like(standing))}, **alone)
    yield _post("labels-of-mask", {"mask": png(crowd)}, "/silhouette")


def _photographs() -> Iterator[Request]:
    street = {"frame": STREET}
    yield _post("street", street, n=2, exact=False)
    yield _post("street-compact", street, n=1, joints="compact", exact=False)
    yield _post("street-coco17", street, n=1, keypoints="coco17", exact=False)
    yield _post(
        "street-blazepose33", street, n=1, joints="none", observed="blazepose33", exact=False
    )
    yield _post("street-by-silhouette", street, n=1, evidence="silhouette", exact=False)
    yield _post("street-by-paper", street, n=3, method="paper", joints="compact", exact=False)
    yield _post("street-and-mask", {**street, "mask": STREET_MASK}, n=1, exact=False)
    yield _post(
        "street-boxes",
        street,
        n=1,
        data={"boxes": "[[130, 158, 50, 114], [220, 145, 50, 107]]"},
        exact=False,
    )
    yield _post("yard-and-background", {"frame": YARD, "background": EMPTY_YARD}, n=1, exact=False)
    yield Request(
        "yard-as-body",
        "POST",
        "/pose",
        {"n": 1},
        exact=False,
        options={"content": YARD, "headers": {"content-type": "image/jpeg"}},
    )
    yield _post("overlay", street, "/pose/overlay", exact=False)
    yield _post("labels-of-street", street, "/silhouette", exact=False)
    yield _post(
        "deepstack",
        {"image": STREET},
        "/v1/vision/detection",
        data={"min_confidence": "0.4"},
        exact=False,
    )


def _session(camera: str, exact: bool) -> Iterator[Request]:
    """A walker before a camera with a zone; a frame of it that is late; an end."""
    path = f"/cameras/{camera}"
    zone = {"name": "gate", "kind": "watch", "polygon": [[0, 0], [180, 0], [180, 330], [0, 330]]}
    yield Request(f"{camera}-0-zones", "PUT", path, options={"json": {"zones": [zone]}})
    for step, (frame, mask) in enumerate(pictures.walk(5)):
        yield _post(
            f"{camera}-{step + 1}",
            {"mask": png(mask)} if exact else {"frame": png(frame)},
            f"{path}/frames",
            n=1,
            joints="compact",
            data={"timestamp": str(100 + 0.2 * step)},
            exact=exact,
        )
    yield _post(
        f"{camera}-6-late", {"mask": STREET_MASK}, f"{path}/frames", data={"timestamp": "100.3"}
    )
    yield Request(f"{camera}-7-forgotten", "DELETE", path)
    yield Request(f"{camera}-8-unknown", "GET", path)


_BED = [{"name": "bed", "kind": "rest", "polygon": [[400, 0], [800, 0], [800, 360], [400, 360]]}]


def _masks(
    camera: str,
    masks: Iterable[pictures.Picture],
    kept: Container[int],
    zones: Sequence[object] = (),
) -> Iterator[Request]:
    """Ten masks a second before a camera, then all events; some of the frames' answers."""
    path = f"/cameras/{camera}"
    yield Request(f"{camera}-zones", "PUT", path, options={"json": {"zones": list(zones)}})
    for step, mask in enumerate(masks):
        yield _post(
            f"{camera}-{step:02}",
            {"mask": png(mask)},
            f"{path}/frames",
            n=1,
            joints="compact",
            data={"timestamp": str(step / 10)},
            kept=step in kept,
        )
    yield Request(f"{camera}-events", "GET", f"{path}/events")


def _named_by_caller() -> Iterator[Request]:
    """Boxes with the caller's identities, which change places in the list."""
    boxes, names = [[130, 158, 50, 114], [220, 145, 50, 107]], ["ann", "bob"]
    for step in range(3):
        data = {"boxes": json.dumps(boxes), "track_ids": json.dumps(names)}
        yield _post(
            f"named-{step}",
            {"frame": STREET},
            "/cameras/named/frames",
            n=1,
            joints="none",
            data={**data, "timestamp": str(step)},
            exact=False,
        )
        boxes, names = boxes[::-1], names[::-1]


def _wide_angle() -> Iterator[Request]:
    """A photograph and a camera whose lens is known and whose pixels are twice as wide as high."""
    optics = {"fov_deg": 72, "pixel_aspect": 2, "n": 1}
    narrow = png(pictures.crowd()[:, ::2])
    yield _post("wide-angle", {"mask": narrow}, **optics, evidence="silhouette")
    yield _post("wide-angle-street", {"frame": STREET}, fov_deg=72, n=1, exact=False)
    yield _post("wide-angle-camera", {"mask": narrow}, "/cameras/wide/frames", **optics)


def _video() -> Iterator[Request]:
    film = pictures.film(5)
    yield _post("video", {"video": film}, "/sequence", n=1, joints="compact", exact=False)
    yield _post(
        "video-some-frames",
        {"video": film},
        "/sequence",
        n=1,
        joints="none",
        stride=2,
        max_frames=2,
        exact=False,
    )


def _index() -> Iterator[Request]:
    yield Request("index", "GET", "/index")
    yield Request("entry", "GET", "/index/entries/20117")
    yield Request("entry-coco17", "GET", "/index/entries/777", {"keypoints": "coco17"})
    yield Request("entry-silhouette", "GET", "/index/entries/20117/silhouette.png")


def _errors() -> Iterator[Request]:
    frame, street = png(np.full((64, 48), 128, np.uint8)), {"frame": STREET}
    large = png(np.zeros((4000, 4000), np.uint8))
    yield _post("error-not-an-image", {"frame": b"no image"})
    yield _post("error-no-frame", {"background": frame})
    yield _post("error-unknown-field", {"frames": frame})
    yield _post("error-unknown-parameter", {"frame": frame}, keypoint="coco17")
    yield _post("error-n", {"frame": frame}, n=51)
    yield _post("error-keypoints", {"frame": frame}, keypoints="coco18")
    figure = png(np.pad(np.ones((40, 20), np.uint8), ((12, 12), (14, 14))))
    yield _post("error-mask-of-another-size", {**street, "mask": figure})
    yield _post("error-boxes", street, data={"boxes": "[[1, 2, 3]]"})
    yield _post("error-box-outside", street, data={"boxes": "[[900, 900, 20, 40]]"})
    yield _post("error-too-many-pixels", {"frame": large})
    yield _post("error-not-a-video", {"video": b"no video"}, "/sequence")
    text = {"content": b"frame", "headers": {"content-type": "text/plain"}}
    yield Request("error-media-type", "POST", "/pose", options=text)
    zones = {"zones": [{"name": "bed", "kind": "sleep", "polygon": [[0, 0], [1, 0], [1, 1]]}]}
    yield Request("error-zones", "PUT", "/cameras/yard", options={"json": zones})
    yield Request("error-entry", "GET", "/index/entries/198000")
    yield Request("error-path", "GET", "/poses")
    yield Request("error-method", "GET", "/pose")
    yield Request("error-no-key", "GET", "/index", service="locked")
    key = {"headers": {"x-api-key": "golden"}}
    yield Request("error-not-ready", "GET", "/index", service="locked", options=key)
