"""Change one place of the code at a time and see whether the tests notice, for a fixed sample.

mutmut makes the mutants and runs the tests that reach each; ``[tool.mutmut]`` in pyproject.toml
names the modules. ``mutmut show NAME`` shows a mutant again, ``mutmut run NAME`` runs it again.
"""

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterable, Sequence
from fnmatch import fnmatch
from hashlib import sha256
from pathlib import Path

from mutmut.configuration import config
from mutmut.mutation.file_mutation import mutate_file_contents
from mutmut.utils.file_utils import walk_source_files
from mutmut.utils.format_utils import get_mutant_name

# Exit codes of the tests: they passed, or none reaches the mutant.
_PASSED, _NOT_REACHED = 0, 33
# Of the sample, survivors that are allowed.
_MOST_PERCENT = 15.0
_PROCESSES = 2


def main(arguments: Sequence[str]) -> int:
    """Print the mutants of a sample that no test notices; 1 if they are too many."""
    parser = argparse.ArgumentParser(description=__doc__, prog=sys.argv[0])
    parser.add_argument("modules", nargs="*", help="patterns of files; all that are configured")
    parser.add_argument("--count", type=int, default=400)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args(arguments)
    os.environ["SHARED"] = "/nonexistent"  # The suite must notice without it.
    chosen = sample(options.modules or ["*"], options.count, options.seed)
    # Results and copied files of another run would be taken for those of this one.
    shutil.rmtree("mutants", ignore_errors=True)
    mutmut = [sys.executable, "-m", "mutmut"]
    subprocess.run([*mutmut, "run", "--max-children", str(_PROCESSES), *chosen], check=True)
    codes = exit_codes()
    unnoticed: dict[str, list[str]] = defaultdict(list)
    for name in chosen:
        if codes[name] in (_PASSED, _NOT_REACHED):
            unnoticed[module_of(name)].append(name)
    for name in sorted(name for names in unnoticed.values() for name in names):
        print("no test reaches" if codes[name] == _NOT_REACHED else "survived", name, flush=True)
        subprocess.run([*mutmut, "show", name], check=True)
    print("| module | mutants | not noticed |\n|---|---|---|")
    for module in sorted(set(map(module_of, chosen))):
        total = sum(module_of(name) == module for name in chosen)
        print(f"| {module} | {total} | {len(unnoticed[module])} |")
    share = 100 * sum(map(len, unnoticed.values())) / len(chosen)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(
        f"{share:.1f} % of {len(chosen)} mutants (seed {options.seed}) are not noticed; "
        f"the tests took {used.ru_utime + used.ru_stime:.0f} core-seconds"
    )
    return int(share > _MOST_PERCENT)


def sample(patterns: Iterable[str], count: int, seed: int) -> list[str]:
    """Names of ``count`` mutants of the modules that match a pattern.

    The order is that of a hash, so that most stay in the sample when others come or go.
    """
    for pattern in config().only_mutate:
        if not list(Path().glob(pattern)):
            raise ValueError(f"pyproject.toml: [tool.mutmut] names {pattern}, which does not exist")
    names = [
        get_mutant_name(path, name)
        for path in walk_source_files()
        if config().should_mutate(path) and any(fnmatch(str(path), one) for one in patterns)
        for name in mutate_file_contents(str(path), path.read_text()).mutant_names
    ]
    if not names:
        raise ValueError(f"expected patterns of configured modules, got {' '.join(patterns)}")
    return sorted(names, key=lambda name: sha256(f"{seed} {name}".encode()).digest())[:count]


def exit_codes() -> dict[str, int | None]:
    """The exit code of the tests of each mutant that was run."""
    return {
        name: code
        for results in Path("mutants").rglob("*.meta")
        for name, code in json.loads(results.read_text())["exit_code_by_key"].items()
    }


def module_of(name: str) -> str:
    """The module of a mutant."""
    return name.rpartition(".")[0]
