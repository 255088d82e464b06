"""Write ``openapi.json``, the committed contract that clients are generated from."""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

from app.main import create_app
from app.settings import Settings
from scripts.results import ROOT


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the document."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=ROOT / "openapi.json")
    output = parser.parse_args(arguments).output
    output.write_text(json.dumps(create_app(Settings()).openapi(), indent=2) + "\n")
    print(output)
