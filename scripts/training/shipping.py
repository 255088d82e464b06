"""The list of the files that ship, kept true to them."""

import hashlib
import json
from pathlib import Path

from app.networks.shipped import FOLDER, LIST


def record_hash(file: Path) -> None:
    """Write the SHA-256 of a new file into ``models.json``, if it is one of those that ship."""
    found = hashlib.sha256(file.read_bytes()).hexdigest()
    print(f"{file}: {file.stat().st_size} bytes, SHA-256 {found}")
    if file.resolve().parent == FOLDER:
        models = json.loads(LIST.read_text())
        for model in models.values():
            if model["file"] == file.name:
                model["sha256"] = found
        LIST.write_text(json.dumps(models, indent=1) + "\n")
