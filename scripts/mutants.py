"""Change one place of the code at a time and see whether the tests notice, for a fixed sample.

The tests run once to learn how long each takes and which lines it reaches. Each mutant is then a
file of a copy of the repository, and a process forked from one that has imported the libraries runs
the tests that reach its line, the quickest first, until one fails.
"""

import argparse
import ast
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from difflib import unified_diff
from fnmatch import fnmatch
from hashlib import sha256
from importlib import import_module
from itertools import accumulate
from pathlib import Path
from typing import Any, NamedTuple

from scripts.results import ROOT

MODULES = [
    "app/bridge/*.py", "app/camera.py", "app/cameras.py", "app/estimation/[fp]*.py", "app/film.py",
    "app/http/[!_]*.py", "app/photograph.py", "app/scheduling/queue.py", "app/tracking/[!a_]*.py",
    "app/decoding/*.py", "app/vision/detector.py", "app/vision/detectors/[!_]*.py",
    "app/vision/judgement.py", "app/vision/p*.py", "app/vision/s*.py", "app/vision/truncation.py",
    "index/landmark*.py", "index/matching.py", "index/modes.py", "index/silhouette_matching.py",
]  # fmt: skip
"""Where answers are decided, and whether an alarm is raised and delivered."""

TESTS = ["tests/app", "tests/api", "tests/index", "tests/golden"]
LIBRARIES = "av cv2 fastapi.testclient faiss httpx hypothesis lap numpy paho.mqtt.client pytest"
FOLDER = ROOT / "mutants"
_MOST_PERCENT = 10.0  # Survivors that are allowed.
_PROCESSES = 2
# Time of the tests that are tried on a mutant, measured without it: most are noticed within a
# second, and 300 are to take a quarter of an hour.
_BUDGET_S = 10.0
# Processor time after which a mutant counts as noticed, since it hangs; and time on a busy machine.
_HANGS_CPU_S, _HANGS_S = 120, 600

_OTHER: dict[type, type] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
    ast.And: ast.Or, ast.Or: ast.And, ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div,
    ast.Div: ast.Mult, ast.FloorDiv: ast.Mult, ast.Mod: ast.Mult, ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd,
}  # fmt: skip


class Mutant(NamedTuple):
    """A changed line of a file, and the whole file with it."""

    name: str
    file: str
    line: int
    source: str


def changed(node: ast.AST) -> Iterator[ast.expr]:
    """Expressions to put in the place of one."""
    if isinstance(node, ast.Compare):
        for place, operator in enumerate(node.ops):
            others = [*node.ops[:place], _OTHER[type(operator)](), *node.ops[place + 1 :]]
            yield ast.Compare(node.left, others, node.comparators)
    elif isinstance(node, ast.BoolOp):
        yield ast.BoolOp(_OTHER[type(node.op)](), node.values)
    elif isinstance(node, ast.BinOp) and type(node.op) in _OTHER:
        yield ast.BinOp(node.left, _OTHER[type(node.op)](), node.right)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub):
        yield node.operand
    elif isinstance(node, ast.IfExp):
        yield ast.IfExp(node.test, node.orelse, node.body)
    elif isinstance(node, ast.Call):
        for number in range(len(node.keywords)):
            keywords = [*node.keywords[:number], *node.keywords[number + 1 :]]
            yield ast.Call(node.func, node.args, keywords)
    elif isinstance(node, ast.Constant):
        yield from (ast.Constant(value) for value in other_values(node.value))


def other_values(value: object) -> Iterator[str | float]:
    """What a number or a name may be instead; nothing for prose."""
    if isinstance(value, bool):
        yield not value
    elif isinstance(value, int | float):
        yield value + 1
    elif isinstance(value, str) and value.count(" ") < 2:
        yield f"X{value}"


def parts(node: ast.AST) -> Iterator[ast.AST]:
    """What is computed in a function: no annotation, no docstring, no part of a text."""
    for name, value in ast.iter_fields(node):
        for child in value if isinstance(value, list) else [value]:
            is_text = isinstance(child, ast.JoinedStr) or (
                isinstance(child, ast.Expr) and isinstance(child.value, ast.Constant)
            )
            if isinstance(child, ast.AST) and name not in ("annotation", "returns") and not is_text:
                yield child
                yield from parts(child)


def mutants_of(file: str, text: str) -> Iterator[Mutant]:
    """All mutants of the functions of a file, whose names hardly change with other lines."""
    content = text.encode()
    begins = [0]
    for line in content.splitlines(keepends=True):
        begins.append(begins[-1] + len(line))
    tree, seen = ast.parse(text), dict[str, int]()
    kinds = ast.FunctionDef | ast.AsyncFunctionDef
    bodies = [line for one in ast.walk(tree) if isinstance(one, kinds) for line in one.body]
    for node in dict.fromkeys(part for body in bodies for part in parts(body)):
        for new in changed(node):
            assert isinstance(node, ast.expr) and node.end_lineno and node.end_col_offset
            begin = begins[node.lineno - 1] + node.col_offset
            end = begins[node.end_lineno - 1] + node.end_col_offset
            written = f"({ast.unparse(new)})".encode()
            what = f"{file}: {ast.unparse(node)} -> {ast.unparse(new)}"
            seen[what] = seen.get(what, 0) + 1
            source = (content[:begin] + written + content[end:]).decode()
            yield Mutant(f"{what} #{seen[what]}", file, node.lineno, source)


def sample(patterns: Sequence[str], count: int, seed: int) -> list[Mutant]:
    """``count`` mutants of the modules that match a pattern, in the order of a hash."""
    files = sorted({str(file) for pattern in MODULES for file in Path().glob(pattern)})
    chosen = [file for file in files if any(fnmatch(file, one) for one in patterns)]
    found = [one for file in chosen for one in mutants_of(file, Path(file).read_text())]
    if not found:
        raise ValueError(f"expected patterns of the modules, got {' '.join(patterns)}")
    return sorted(found, key=lambda one: sha256(f"{seed} {one.name}".encode()).digest())[:count]


class Timed:
    """A plugin of pytest that adds up the time of each test."""

    def __init__(self, file: Path) -> None:
        self._file, self._seconds = file, dict[str, float]()

    def pytest_runtest_logreport(self, report: Any) -> None:
        """Add the time of a part of a test."""
        known = self._seconds.get(report.nodeid, 0.0)
        self._seconds[report.nodeid] = known + report.duration

    def pytest_unconfigure(self) -> None:
        """Write what was added up."""
        self._file.write_text(json.dumps(self._seconds))


class Chosen:
    """A plugin of pytest that runs these tests, in this order."""

    def __init__(self, tests: Sequence[str]) -> None:
        self._places = {test: place for place, test in enumerate(tests)}

    def pytest_collection_modifyitems(self, items: list[Any]) -> None:
        """Choose among what was collected."""
        wanted = [item for item in items if item.nodeid in self._places]
        items[:] = sorted(wanted, key=lambda item: self._places[item.nodeid])


class Reach:
    """The time of each test, and the tests that reach each line of the code."""

    def __init__(self, tests: Sequence[str]) -> None:
        import coverage

        timed = FOLDER / "seconds.json"
        tracing = ["--cov", "--cov-context=test", "--cov-report=", "--cov-fail-under=0"]
        options = ["-q", "-n", str(_PROCESSES), "--dist", "loadfile", *tracing]
        if status := forked([*options, *tests], Timed(timed), limited=False):
            raise SystemExit(f"expected tests that pass, got the exit status {status}")
        self.seconds: dict[str, float] = json.loads(timed.read_text())
        self._data = coverage.CoverageData(str(ROOT / ".coverage"))
        self._data.read()

    def tests_of(self, mutant: Mutant) -> list[str]:
        """The tests that reach a mutant, the quickest first, within the budget.

        Those of the code's folder, where other processes alone run it.
        """
        by_line = self._data.contexts_by_lineno(str(ROOT / mutant.file))
        # An expression may begin below the line of its statement.
        lines = [line for line in range(mutant.line, 0, -1) if any(by_line.get(line, ()))]
        reaching = {name.rpartition("|")[0] for name in by_line[lines[0]]} if lines else set()
        folder = f"tests/{Path(mutant.file).parent}/"
        known = [one for one in self.seconds if one in reaching]
        known = known or [one for one in self.seconds if one.startswith(folder)]
        known.sort(key=self.seconds.__getitem__)
        total = accumulate(self.seconds[one] for one in known)
        return [one for one, seconds in zip(known, total, strict=True) if seconds <= _BUDGET_S]


def forked(arguments: Sequence[str], plugin: object, *, limited: bool = True) -> int:
    """Run pytest in a process of its own; return its exit status, or minus the signal's number."""
    process = os.fork()
    if not process:
        import pytest

        os.setsid()
        if limited:
            resource.setrlimit(resource.RLIMIT_CPU, (_HANGS_CPU_S, _HANGS_CPU_S))
            signal.alarm(_HANGS_S)
        with (FOLDER / f"{os.getpid()}.log").open("wb") as log:
            os.dup2(log.fileno(), 1)
            os.dup2(log.fileno(), 2)
        os._exit(int(pytest.main(["-p", "no:cacheprovider", *arguments], [plugin])))
    _, status = os.waitpid(process, 0)
    with suppress(ProcessLookupError):
        os.killpg(process, signal.SIGKILL)  # What its tests have started.
    return os.waitstatus_to_exitcode(status)


def noticed(mutants: Sequence[Mutant], reach: Reach, copied: Path) -> dict[str, bool]:
    """Whether a test notices each mutant, in a copy of the repository."""
    listed = subprocess.run(
        ["git", "ls-files", "-coz", "--exclude-standard"], cwd=ROOT, capture_output=True, check=True
    ).stdout.decode()
    for name in filter(None, listed.split("\0")):
        if (ROOT / name).is_file():
            (copied / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, copied / name)
    os.chdir(copied)
    sys.path.insert(0, str(copied))
    for library in LIBRARIES.split():
        import_module(library)

    def fails(tests: Sequence[str]) -> bool:
        files = list(dict.fromkeys(test.partition("::")[0] for test in tests))
        return bool(tests) and forked(["-q", "-x", *files], Chosen(tests)) != 0

    answers = dict[str, bool]()
    for number, mutant in enumerate(mutants):
        tests, file = reach.tests_of(mutant), copied / mutant.file
        if not number and fails(tests):
            raise SystemExit(f"expected tests that pass without a mutant, got {tests}")
        file.write_text(mutant.source)
        answers[mutant.name] = fails(tests)
        shutil.copy2(ROOT / mutant.file, file)
    return answers


def main(arguments: Sequence[str]) -> int:
    """Print the mutants of a sample that no test notices; 1 if they are too many."""
    parser = argparse.ArgumentParser(description=__doc__, prog=sys.argv[0])
    parser.add_argument(
        "modules", nargs="*", default=["*"], help="patterns of files; by default all"
    )
    parser.add_argument("--count", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--tests", nargs="+", default=TESTS, help="what pytest is given")
    options = parser.parse_args(arguments)
    # The suite must notice without it; the bytes of a mutant are not those of its file's.
    os.environ |= {"SHARED": "/nonexistent", "PYTHONDONTWRITEBYTECODE": "1"}
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    sys.dont_write_bytecode = True
    os.chdir(ROOT)
    shutil.rmtree(FOLDER, ignore_errors=True)
    FOLDER.mkdir()
    mutants = sample(options.modules, options.count, options.seed)
    began, reach = time.monotonic(), Reach(options.tests)
    print(f"{len(reach.seconds)} tests, {time.monotonic() - began:.0f} s", flush=True)
    workers = []
    for number in range(_PROCESSES):
        if not (process := os.fork()):
            answers = noticed(mutants[number::_PROCESSES], reach, FOLDER / str(number))
            (FOLDER / f"{number}.json").write_text(json.dumps(answers))
            os._exit(0)
        workers.append(process)
    if any(os.waitpid(process, 0)[1] for process in workers):
        raise SystemExit("expected an answer about each mutant, got none: a worker failed")
    answers = dict[str, bool]()
    for number in range(_PROCESSES):
        answers |= json.loads((FOLDER / f"{number}.json").read_text())
    survivors = [one for one in mutants if not answers[one.name]]
    for one in sorted(survivors):
        print(*unified_diff((ROOT / one.file).read_text().splitlines(), one.source.splitlines(),
                            one.name, "survived", n=0, lineterm=""), sep="\n")  # fmt: skip
    print("| module | mutants | not noticed |\n|---|---|---|")
    for file in sorted({one.file for one in mutants}):
        total, left = (sum(one.file == file for one in some) for some in (mutants, survivors))
        print(f"| {file} | {total} | {left} |")
    share, used = 100 * len(survivors) / len(mutants), resource.getrusage(resource.RUSAGE_CHILDREN)
    print(
        f"{share:.1f} % of {len(mutants)} mutants (seed {options.seed}) are not noticed; it took "
        f"{time.monotonic() - began:.0f} s, {used.ru_utime + used.ru_stime:.0f} core-seconds"
    )
    return int(share > _MOST_PERCENT)
