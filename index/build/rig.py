"""Motion of another rig: what its joints are called, and how long its unit is.

A motion folder whose BVH files are not CMU's holds a ``rig.json``::

    {"metres_per_unit": 0.01, "joints": {"Hips": "mixamorig:Hips", "LowerBack": "mixamorig:Spine"}}

``joints`` names for a joint of ours the joint of the files that turns it; one of theirs may serve
several of ours. Joints left out are called as ours are.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

FILE = "rig.json"

METRES_PER_UNIT = 0.05644
"""CMU's unit of length."""


class MotionError(ValueError):
    """Motion data that cannot be used; the message names the file and what is wrong."""


@dataclass(frozen=True)
class Rig:
    """How the joints of some BVH files correspond to ours.

    Parameters
    ----------
    joints : mapping of str to str
        Joints of the files by the names of ours; those left out have the same name.
    metres_per_unit : float
    """

    joints: Mapping[str, str] = field(default_factory=dict)
    metres_per_unit: float = METRES_PER_UNIT


CMU = Rig()


def read_rig(folder: Path) -> Rig:
    """Read the rig of a motion folder; CMU's where it names none.

    Raises
    ------
    MotionError
        If its file is malformed.
    """
    file = Path(folder) / FILE
    if not file.exists():
        return CMU
    try:
        values = json.loads(file.read_text(encoding="utf-8"))
        joints, unit = values.get("joints", {}), values.get("metres_per_unit", METRES_PER_UNIT)
        unknown = set(values).difference(("joints", "metres_per_unit"))
        if unknown:
            raise ValueError(f"{', '.join(sorted(unknown))} is not known")
        if not all(isinstance(name, str) for name in joints.values()):
            raise ValueError("joints names something that is not a joint")
        if not (isinstance(unit, int | float) and 0 < unit < float("inf")):
            raise ValueError(f"expected metres_per_unit above 0, got {unit!r}")
    except (OSError, AttributeError, ValueError) as error:
        raise MotionError(f"{file} does not describe a rig: {error}") from error
    return Rig(dict(joints), float(unit))
