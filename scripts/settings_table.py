"""Write the table of settings into ``docs/operations.md``, from the settings themselves.

python -m scripts.settings_table
"""

from __future__ import annotations

from pathlib import Path

from pydantic.fields import FieldInfo

from app.settings import Settings, variable
from scripts.results import ROOT, write_section

OPERATIONS = ROOT / "docs" / "operations.md"
TITLE = "Settings"

INTRODUCTION = """
Environment variables configure everything; an empty one counts as not set. An invalid value, an
unknown name that begins with `POSE_`, or a port that is in use stops the start with status 1 and
one sentence that names the variable.
"""


def table() -> str:
    """Return all settings as a table in Markdown."""
    rows = [
        f"| `{variable(name, field)}` | {_default(field)} | {field.description or _plain(name)} |"
        for name, field in Settings.model_fields.items()
    ]
    return "\n".join(["| variable | default | meaning |", "|---|---|---|", *rows])


def section() -> str:
    """Return the text of the section."""
    return f"{INTRODUCTION.strip()}\n\n{table()}"


def _plain(name: str) -> str:
    return f"{name.replace('_', ' ').capitalize()}."


def _default(field: FieldInfo) -> str:
    if field.default_factory is not None:
        return "cores, or the container's quota"
    value = field.default
    if isinstance(value, Path):
        return f"`{value.relative_to(ROOT)}` of the service"
    if value == ():
        return "none"
    return f"`{value}`"


if __name__ == "__main__":
    write_section(OPERATIONS, TITLE, section())
    print(OPERATIONS)
