"""What every measurement states beside its figures: revision and machine."""

import platform
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
SHARED = ROOT.parent / "shared"
RESULTS = ROOT / "docs" / "results"


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


def percentile(values: Sequence[float], share: float) -> float:
    """Return a percentile, 0 where there are no values."""
    return float(np.percentile(values, share)) if values else 0.0
