"""Write ``openapi.json``, the committed contract that clients are generated from.

python -m scripts.export_openapi [--output openapi.json]
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from app.main import create_app
from app.settings import Settings
from scripts.results import ROOT


def render() -> str:
    """Return the document as it is committed."""
    return json.dumps(create_app(Settings()).openapi(), indent=2) + "\n"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description="Write the OpenAPI document.")
    parser.add_argument("--output", type=Path, default=ROOT / "openapi.json")
    options = parser.parse_args()
    options.output.write_text(render())
    print(options.output)


if __name__ == "__main__":
    main()
