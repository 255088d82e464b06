"""Every curl command of README.md and docs/api.md does what it says, against a live server."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.conftest import HTTP, ROOT, SHARED, WALKERS, Server

README = ROOT / "README.md"
API = ROOT / "docs" / "api.md"

_BLOCK = re.compile(r"^```(?:sh|bash|shell|console)[^\n]*\n(.*?)^```", re.MULTILINE | re.DOTALL)
_SERVICE = re.compile(r"(?:https?://)?(?:localhost|127\.0\.0\.1)(?::\d+)?")
_FILE = re.compile(r"@([^\s;,'\"\\]+)")
# curl's own report goes to standard error, the answer stays what the reader would see.
_CURL = "curl() { command curl -sS -w '%{stderr}%{http_code} %{content_type}\\n' \"$@\"; }\n"


def curl_commands(text: str) -> list[str]:
    """The commands of a Markdown text that begin with ``curl``, with continued lines."""
    commands: list[str] = []
    for block in _BLOCK.findall(text):
        continued = False
        for line in block.splitlines():
            line = line.removeprefix("$ ")
            if continued:
                commands[-1] += "\n" + line
            elif line.startswith("curl "):
                commands.append(line)
            else:
                continue
            continued = line.endswith("\\")
    return commands


COMMANDS = list(
    dict.fromkeys(command for page in (README, API) for command in curl_commands(page.read_text()))
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where all commands run, in order: a later one may send what an earlier one has saved."""
    return tmp_path_factory.mktemp("readme")


def placed(command: str, folder: Path) -> str:
    """The command with the files it sends named so that they are found from the folder."""

    def place(match: re.Match[str]) -> str:
        name = match.group(1)
        if (folder / name).exists():
            return match.group(0)
        if name.startswith("../shared/"):
            path = SHARED / name.removeprefix("../shared/")
            if not path.exists():
                pytest.skip(f"needs {name}, which is not there")
        else:
            path = ROOT / name
            assert path.exists(), f"a page sends {name}, which is not in the repository"
        return f"@{path.resolve()}"

    return _FILE.sub(place, command)


def resembles(shown: object, answered: object, path: str = "reply", *, whole: bool) -> None:
    """Assert that an answer has the fields and values that a page shows.

    ``"..."`` stands for what is left out of a list; fields may be left out unless the page shows
    the ``whole`` of it. Networks round differently from processor to processor.
    """
    if isinstance(shown, dict):
        assert isinstance(answered, dict), path
        expected = list(answered) if whole and path != "reply" else list(shown)
        assert list(shown) == [key for key in answered if key in expected], path
        for key, value in shown.items():
            resembles(value, answered[key], f"{path}.{key}", whole=whole)
    elif isinstance(shown, list) and shown:
        assert isinstance(answered, list), path
        skipped = 1 if shown[0] == "..." else 0
        for number, value in enumerate(shown[skipped:-1], start=skipped):
            resembles(value, answered[number], f"{path}[{number}]", whole=whole)
        assert len(answered) >= len(shown) - 1, path
    elif isinstance(shown, float):
        assert answered == pytest.approx(shown, rel=0.01, abs=0.005), path
    else:
        assert answered == shown, path


@pytest.mark.parametrize("page", [README, API], ids=lambda page: page.stem)
def test_the_reply_is_the_one_shown(page: Path, shipped_server: Server) -> None:
    shown = json.loads(re.findall(r"^```json\n(.*?)^```", page.read_text(), re.M | re.S)[0])
    with WALKERS.open("rb") as frame:
        files = {"frame": frame}
        answer = HTTP.post(f"{shipped_server.url}/pose", params={"n": 7}, files=files)
    resembles(shown, answer.json(), whole=page == API)


@pytest.mark.parametrize("command", COMMANDS)
def test_it_works(command: str, shipped_server: Server, folder: Path) -> None:
    for tool in ("curl", *re.findall(r"\|\s*([\w.-]+)", command)):
        if shutil.which(tool) is None:
            pytest.skip(f"needs {tool}")
    script = _CURL + _SERVICE.sub(shipped_server.url, placed(command, folder))
    assert shipped_server.url in script, "the command does not call the service"
    before = set(folder.iterdir())
    result = subprocess.run(
        ["/bin/sh", "-c", script], cwd=folder, capture_output=True, timeout=60, check=False
    )
    report = result.stderr.decode()
    assert result.returncode == 0, report
    status, _, content_type = report.strip().splitlines()[-1].partition(" ")
    assert status.startswith("2"), report + result.stdout.decode(errors="replace")[:500]
    saved = [path for path in folder.iterdir() if path not in before]
    content = saved[0].read_bytes() if saved else result.stdout
    if content_type.startswith("image/png"):
        assert content.startswith(b"\x89PNG")
    elif content_type.startswith("application/json") and "|" not in command:
        json.loads(content)
    else:
        assert bool(content) == (status != "204")
