"""Measure again what is older than the code: ``make results``.

    python -m scripts results [--list]

A page is stale if ``app``, ``index`` or ``descriptor`` have changed since its revision. The
experiments of all stale pages run in turn; stopped and started again, the command goes on.
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence

from scripts.evaluate import EXPERIMENTS
from scripts.figures import RELIABILITY
from scripts.results import RESULTS, ROOT

CODE = ("app", "index", "descriptor")
COMMANDS = {
    **{name: ("evaluate", name) for name in EXPERIMENTS},
    **{name: (name, "--write") for name in ("bench", "peer", "profile", *RELIABILITY)},
}
"""What measures each page, or each section of the page of reliability."""


def stale(name: str) -> str | None:
    """Return why a page has to be measured again, or None."""
    file = RESULTS / f"{'reliability' if name in RELIABILITY else name}.json"
    page = json.loads(file.read_text()) if file.exists() else {"figures": {}}
    origin = page["figures"].get(name, {}) if name in RELIABILITY else page
    if "revision" not in origin:
        return "never measured"
    commits = _git("rev-list", "--count", f"{origin['revision']}..HEAD", "--", *CODE) or "unknown"
    measured = f"measured at {origin['revision']} ({origin['date']})"
    return None if commits == "0" else f"{measured}, {commits} commits of {', '.join(CODE)} ago"


def _git(*arguments: str) -> str:
    command = ["git", *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True).stdout.strip()


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; 1 if a page is stale in the end."""
    parser = argparse.ArgumentParser(description="Measure again what is older than the code.")
    parser.add_argument("--list", action="store_true", help="only list the stale pages")
    plays = not parser.parse_args(arguments).list
    if plays and _git("status", "--porcelain", "--", *CODE):
        raise ValueError(f"expected a revision, got uncommitted changes of {', '.join(CODE)}")
    for name, command in COMMANDS.items():
        if why := stale(name):
            print(f"{name}: {why}", flush=True)
            if plays:  # An exit status of 1 may only say that a target was missed.
                subprocess.run([sys.executable, "-m", "scripts", *command], cwd=ROOT, check=False)
    return int(any(stale(name) for name in COMMANDS))
