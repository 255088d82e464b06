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

Steps = tuple[int | str, ...]
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


_Web = Annotated[SplitResult, NoDecode, _address("http", "https")]
_Broker = Annotated[SplitResult | None, NoDecode, _address("mqtt", "mqtts")]


class Camera(CameraConfiguration):
    """A camera: where its frames come from, and how the service is to see it."""

    model_config = ConfigDict(coerce_numbers_to_str=True)

    source: Annotated[str, PlainValidator(_source)]  # File, device's number, or URL of a stream.
    name: Annotated[str, Field(min_length=1, max_length=64)] | None = None  # For Home Assistant.
    fps: float = Field(10.0, gt=0, allow_inf_nan=False)  # At most.

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

    url: _Web = urlsplit("http://127.0.0.1:8000")  # Of the service, as the key is.
    api_key: SecretStr | None = None
    webhook: Annotated[tuple[_Web, ...], NoDecode, BeforeValidator(_listed)] = ()  # Or only one.
    mqtt: _Broker = None
    queue: Path | None = None  # A file that keeps events that wait.
    cameras: Annotated[dict[CameraId, Camera], NoDecode] = Field(min_length=1)

    def of(self, camera_id: str) -> "Settings":
        """Return the settings of one camera alone."""
        return self.model_copy(update={"cameras": {camera_id: self.cameras[camera_id]}})


def read_file(path: Path) -> Settings:
    """Read a file of cameras, in YAML; a SettingsError names the line and the field."""
    lines: dict[Steps, int] = {(): 1}
    try:
        loader = yaml.SafeLoader(path.read_text("utf-8-sig"))
        node = loader.get_single_node()
        given = {} if node is None else _plain(node, loader, lines)
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

    def place(steps: Steps) -> str:
        line = next(lines[steps[:n]] for n in range(len(steps), -1, -1) if steps[:n] in lines)
        return f"{path}, line {line}: {dotted(steps)}"

    return settings_from(given, place)


def settings_from(given: Mapping[str, Any], place: Callable[[Steps], str]) -> Settings:
    """Check what is given, and the environment; a SettingsError begins with the place."""
    try:
        return Settings(**given)
    except ValidationError as error:
        first = error.errors()[0]
        cause = first.get("ctx", {}).get("error")
        steps = tuple(step for step in first["loc"] if step != "[key]")
        if isinstance(cause, UnknownNameError):
            steps = *steps, cause.name
        variable = f"{PREFIX}{steps[0]}".upper()
        is_variable = steps[0] not in given and variable in os.environ
        sentence = "expected text" if steps[0] == "api_key" else expected_and_got(first)
        sentence = re.sub(r"//\S*@", "//", sentence).replace("a JSON object", "fields")
        raise SettingsError(f"{variable if is_variable else place(steps)}: {sentence}") from None


def _plain(
    node: yaml.Node, loader: yaml.SafeLoader, lines: dict[Steps, int], steps: Steps = ()
) -> Any:
    """What a node says, with the lines of what is in it; names are text, as they are written."""
    if isinstance(node, yaml.SequenceNode):
        named = dict(enumerate(node.value))
        marks = {number: value.start_mark for number, value in named.items()}
    elif isinstance(node, yaml.MappingNode):
        names = [key.value for key, _ in node.value]
        for key, _ in node.value:
            if names.count(key.value) > 1:
                problem = f"{key.value} is there twice"
                raise yaml.MarkedYAMLError(problem=problem, problem_mark=key.start_mark)
        loader.flatten_mapping(node)  # What `<<` merges.
        named = {key.value: value for key, value in node.value}
        marks = {key.value: key.start_mark for key, _ in node.value}
    else:
        return loader.construct_object(node)
    lines |= {(*steps, name): mark.line + 1 for name, mark in marks.items()}
    plain = {name: _plain(one, loader, lines, (*steps, name)) for name, one in named.items()}
    return list(plain.values()) if isinstance(node, yaml.SequenceNode) else plain
