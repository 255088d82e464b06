"""Files of results: each measurement owns a section and leaves the others alone."""

from __future__ import annotations

import argparse
import platform
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from index import DEFAULT_PATH

ROOT = Path(__file__).resolve().parent.parent
RELIABILITY = ROOT / "docs" / "results" / "reliability.md"


def machine() -> str:
    """Describe this machine in a line."""
    model = platform.processor() or platform.machine()
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            model = line.split(":", 1)[1].strip()
            break
    cores = len(list(Path("/sys/devices/system/cpu").glob("cpu[0-9]*")))
    return f"{model}, {cores} cores, Python {platform.python_version()}"


def revision() -> str:
    """Return the git revision of the checkout, ``unknown`` outside one."""
    command = ["git", "rev-parse", "--short", "HEAD"]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    return result.stdout.strip() or "unknown"


def percentile(values: list[float], share: float) -> float:
    """Return a percentile, 0 where there are no values."""
    return float(np.percentile(values, share)) if values else 0.0


def measurement_parser(description: str) -> argparse.ArgumentParser:
    """Make a command line with what every measurement of a server takes."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--index", type=Path, default=DEFAULT_PATH)
    parser.add_argument("--write", action="store_true", help=f"into {RELIABILITY.name}")
    return parser


def conclude(title: str, body: str, failed: Sequence[str], *, write: bool) -> int:
    """Print a section, put it into the page where that is asked, and return the exit status."""
    body += f"\n\n{'Failed: ' + '; '.join(failed) if failed else 'Passed.'}"
    print(body)
    if write:
        write_section(RELIABILITY, title, body)
    return 1 if failed else 0


def write_section(file: Path, title: str, body: str) -> None:
    """Put a section into a Markdown file, in place of the one of that title if there is one."""
    text = file.read_text() if file.exists() else f"# {file.stem.capitalize()}\n"
    heading = f"\n## {title}\n"
    section = f"{heading}\n{body.strip()}\n"
    start = text.find(heading)
    if start < 0:
        text = text.rstrip("\n") + "\n" + section
    else:
        end = text.find("\n## ", start + 1)
        text = text[:start] + section + (text[end:] if end >= 0 else "")
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text)
