"""What the bridge is to do: one schema for a file of cameras and for a command line."""

import os
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import SplitResult, urlsplit

import yaml
from pydantic import BeforeValidator, ConfigDict, Field, PlainValidator, SecretStr, ValidationError
from pydantic_settings import BaseSettings, NoDecode, SettingsConfigDict

from app.configuration import CameraConfiguration, CameraId, Given, UnknownNameError
from app.messages import dotted, expected_and_got

PREFIX = "WATCH_"

Steps = Sequence[int | str]
"""Names and numbers that lead to a value."""


class SettingsError(ValueError):
    """The bridge cannot do what it is told; the message is one sentence without passwords."""


# None of these repeats an address, which may hold a password.
def _address(*schemes: str) -> PlainValidator:
    def parse(given: object) -> SplitResult | None:
        if given is None or isinstance(given, SplitResult):
            return given
        text = str(given)
        try:
            address = urlsplit(text)
            is_sound = address.scheme in schemes and address.hostname and address.port != 0
        except ValueError:
            is_sound = False
        if not is_sound or not re.fullmatch("[!-~]+", text):
            expected = " or ".join(f"{scheme}://HOST[:PORT]" for scheme in schemes)
            raise ValueError(f"expected {expected}, got something else")
        return address

    return PlainValidator(parse)


def _source(given: object) -> str:
    source = "" if given is None else str(given)
    if not (source.isdecimal() or "://" in source or Path(source).is_file()):
        shown = source.rpartition("@")[2] or "nothing"
        raise ValueError(f"expected a file, a number or a URL, got {shown}")
    return source


def _listed(given: object) -> Sequence[object]:
    return given if isinstance(given, list | tuple) else () if given is None else [given]


_Web = Annotated[SplitResult, _address("http", "https")]
_Broker = Annotated[SplitResult | None, _address("mqtt", "mqtts")]


class Camera(CameraConfiguration):
    """A camera: where its frames come from, and how the service is to see it."""

    model_config = ConfigDict(coerce_numbers_to_str=True)

    source: Annotated[str, PlainValidator(_source)]
    """File, number of a device, or URL of a stream."""
    name: Annotated[str, Field(min_length=1, max_length=64)] | None = None
    """What Home Assistant calls the camera."""
    fps: float = Field(10.0, gt=0, allow_inf_nan=False)
    """Most frames a second."""

    @property
    def configuration(self) -> dict[str, Any] | None:
        """Body of ``PUT /cameras/{camera_id}``; None if nothing is said of it."""
        given = self.model_fields_set & CameraConfiguration.model_fields.keys()
        return self.model_dump(mode="json", include=given) if given else None


class Settings(Given, BaseSettings):
    """Cameras by their names, their service, and who learns of their events."""

    model_config = SettingsConfigDict(
        env_prefix=PREFIX, env_ignore_empty=True, coerce_numbers_to_str=True
    )

    url: _Web = urlsplit("http://127.0.0.1:8000")
    """Of the service."""
    api_key: SecretStr | None = None
    webhook: Annotated[tuple[_Web, ...], NoDecode, BeforeValidator(_listed)] = ()
    """One URL or several, which events are posted to."""
    mqtt: _Broker = None
    queue: Path | None = None
    """File that keeps events that wait."""
    cameras: Annotated[dict[CameraId, Camera], NoDecode] = Field(min_length=1)

    def of(self, camera_id: str) -> "Settings":
        """Return the settings of one camera alone."""
        return self.model_copy(update={"cameras": {camera_id: self.cameras[camera_id]}})


def read_file(path: Path) -> Settings:
    """Read a file of cameras, in YAML; a SettingsError names the line and the field."""
    try:
        loader = yaml.SafeLoader(path.read_text("utf-8-sig"))
        root = loader.get_single_node()
        given = None if root is None else _plain(root, loader)
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise SettingsError(f"expected a file of cameras, got {path}: {reason}") from None
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        raise SettingsError(f"{path}, line {line}: expected YAML: {error.problem}") from None
    except (yaml.YAMLError, ValueError, RecursionError):
        raise SettingsError(f"{path}: expected a text of YAML, got something else") from None
    if not isinstance(given, dict):
        raise SettingsError(f"{path}: expected fields such as cameras, got none")
    return settings_from(given, lambda steps: f"{path}, line {_line(root, steps)}: {dotted(steps)}")


def settings_from(given: Mapping[str, Any], place: Callable[[Steps], str]) -> Settings:
    """Check what is given, and the environment; a SettingsError begins with the place."""
    try:
        return Settings(**given)
    except ValidationError as error:
        first = error.errors()[0]
        cause = first.get("ctx", {}).get("error")
        unknown = [cause.name] if isinstance(cause, UnknownNameError) else []
        steps = [step for step in first["loc"] if step != "[key]"] + unknown
        variable = f"{PREFIX}{steps[0]}".upper()
        is_variable = steps[0] not in given and variable in os.environ
        is_secret = steps[0] == "api_key"
        sentence = "expected text" if is_secret else expected_and_got(first)
        sentence = re.sub(r"//\S*@", "//", sentence).replace("a JSON object", "fields")
        where = variable if is_variable else place(steps)
        raise SettingsError(f"{where}: {sentence}") from None


def _plain(node: yaml.Node, loader: yaml.SafeLoader) -> Any:
    """What a node says; names of fields and cameras are text, whatever they look like."""
    if isinstance(node, yaml.SequenceNode):
        return [_plain(value, loader) for value in node.value]
    if not isinstance(node, yaml.MappingNode):
        return loader.construct_object(node)
    names = [key.value for key, _ in node.value]
    for number, (key, _) in enumerate(node.value):
        if key.value in names[:number]:
            raise yaml.MarkedYAMLError(
                problem=f"{key.value} is there twice", problem_mark=key.start_mark
            )
    loader.flatten_mapping(node)  # What `<<` merges.
    return {key.value: _plain(value, loader) for key, value in node.value}


def _line(node: yaml.Node, steps: Steps) -> int:
    """Number of the line that steps lead to, as far as there is a node."""
    mark = node.start_mark
    for step in steps:
        if isinstance(node, yaml.MappingNode):
            found = [pair for pair in node.value if pair[0].value == step]
        elif isinstance(node, yaml.SequenceNode):
            found = [(one, one) for number, one in enumerate(node.value) if number == step]
        else:
            break
        if not found:
            break
        key, node = found[-1]
        mark = key.start_mark
    return mark.line + 1
