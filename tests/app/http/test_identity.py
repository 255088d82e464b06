"""Identities: the caller by key or address, and the camera that a request names."""

import pytest
from pydantic import SecretStr

from app.http.identity import Identity, identify

KEYS = (SecretStr("first"), SecretStr("second"))


def identity(path: str = "/pose", keys: tuple[SecretStr, ...] = (), **headers: str) -> Identity:
    pairs = [(name.replace("_", "-").encode(), value.encode()) for name, value in headers.items()]
    scope = {"type": "http", "path": path, "headers": pairs, "client": ("10.0.0.7", 4711)}
    return identify(scope, keys)


@pytest.mark.parametrize(
    ("headers", "position"),
    [
        ({}, None),
        ({"x_api_key": "second"}, 1),
        ({"authorization": "bearer first"}, 0),
        ({"x_api_key": "wrong", "authorization": "Bearer second"}, 1),
        ({"authorization": "Basic first"}, None),
    ],
)
def test_a_caller_is_known_by_its_key(headers: dict[str, str], position: int | None) -> None:
    found = identity(keys=KEYS, **headers)
    assert found.caller == (position, "10.0.0.7")
    assert found.is_authorised == (position is not None)
    assert identity(**headers) == found._replace(
        caller=found.caller._replace(key=None), is_authorised=True
    )


def test_a_stream_is_the_frames_of_one_camera_route_and_key() -> None:
    yard = identity(keys=KEYS, x_camera_id="yard", x_api_key="first").stream
    assert yard == identity(keys=KEYS, x_camera_id="yard", authorization="Bearer first").stream
    others = (
        identity(keys=KEYS, x_camera_id="gate", x_api_key="first"),
        identity("/silhouette", KEYS, x_camera_id="yard", x_api_key="first"),
        identity("/cameras/yard/frames", KEYS, x_api_key="first"),
        identity(keys=KEYS, x_camera_id="yard", x_api_key="second"),
    )
    assert len({yard, *(other.stream for other in others)}) == 5


def test_without_keys_credentials_make_no_other_stream() -> None:
    """As those of a proxy: all callers share the cameras."""
    yard = identity(x_camera_id="yard").stream
    assert yard == identity(x_camera_id="yard", authorization="Basic eA==").stream
    assert yard == identity(x_camera_id="yard", x_api_key="any").stream


@pytest.mark.parametrize("name", ["", "..", "a b", "x" * 65])
def test_an_invalid_name_is_no_camera(name: str) -> None:
    assert identity(x_camera_id=name).stream is None
    assert identity().stream is None
