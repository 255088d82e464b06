"""What every measurement states beside its figures: revision, its date, and machine."""

import platform
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
SHARED = ROOT.parent / "shared"
RESULTS = ROOT / "docs" / "results"


_INSTRUCTIONS = {
    "avx2": "AVX2",
    "avx512f": "AVX512",
    "avx512_vnni": "VNNI",
    "avx_vnni": "VNNI",
    "avx512_bf16": "BF16",
    "amx_tile": "AMX",
}
"""Flags in /proc/cpuinfo on which the time of a network depends."""


def machine() -> str:
    """Describe this machine in a line."""
    lines = (line.split(":", 1) for line in Path("/proc/cpuinfo").read_text().splitlines())
    known = {line[0].strip(): line[1].strip() for line in lines if len(line) == 2}
    model = known.get("model name") or platform.processor() or platform.machine()
    flags = set(known.get("flags", "").split())
    sets = dict.fromkeys(name for flag, name in _INSTRUCTIONS.items() if flag in flags)
    cores = len(list(Path("/sys/devices/system/cpu").glob("cpu[0-9]*")))
    parts = [f"{model} with {', '.join(sets)}" if sets else model, f"{cores} cores"]
    return f"{'; '.join(parts)}; Python {platform.python_version()}"


def revision() -> str:
    """Return the git revision of the checkout, ``unknown`` outside one."""
    return _of_head("%h")


def date() -> str:
    """Return the date of the revision, ``unknown`` outside a checkout."""
    return _of_head("%cs")


def _of_head(form: str) -> str:
    command = ["git", "show", "--no-patch", f"--format={form}", "HEAD"]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    return result.stdout.strip() or "unknown"


def percentile(values: Sequence[float], share: float) -> float:
    """Return a percentile, 0 where there are no values."""
    return float(np.percentile(values, share)) if values else 0.0
