"""Shards: cut anywhere they give the same bytes, and what is drawn is not drawn again."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np
import pytest

from index.build import shard_files
from index.build import simulate as module
from index.build.body import Avatar
from index.build.poses import Poses, merged
from index.build.shard_files import ShardError, Task, code_version, name_of, write_avatars
from index.build.simulate import Simulation, simulate
from index.build.workers import Result, Threads
from index.build.workers import Task as AnyTask
from tests.index.build.test_simulate import assert_same


class Noted:
    """Threads that note what they are asked for, and stop after some."""

    def __init__(self, stop_after: int | None = None) -> None:
        self.files: list[Path] = []
        self.shards: list[module.Shard] = []
        self.stop_after = stop_after

    def map(
        self, perform: Callable[[AnyTask], Result], tasks: Iterable[AnyTask]
    ) -> Iterator[Result]:
        for task in tasks:
            if len(self.files) == self.stop_after:
                raise InterruptedError
            assert isinstance(task, Task)
            self.files.append(task.file)
            self.shards.append(task.shard)
            yield perform(task)


@pytest.fixture(scope="module")
def some(poses: Poses, laid: Poses) -> Poses:
    """Recorded poses and some laid down, mixed."""
    return merged([poses.take(np.arange(0, 14)), laid.take(np.arange(6)), poses.take([20, 47])])


def drawn(some: Poses, avatars: list[Avatar], **settings: object) -> Simulation:
    return simulate(
        some, avatars, bodies=2, views=3, seed=5, only_new=True, **settings  # type: ignore[arg-type]
    )  # fmt: skip


@pytest.mark.parametrize("size", [1, 2, 5, 21, 22, 23])
def test_same_bytes_in_shards_of_any_size(
    some: Poses, avatars: list[Avatar], size: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert len(some) == 22
    whole = drawn(some, avatars)
    monkeypatch.setattr(module, "SHARD_POSES", size)
    workers = Noted()
    assert_same(drawn(some, avatars, workers=workers), whole)
    assert len(workers.files) == -(-22 // size)


class TestResume:
    @pytest.fixture(autouse=True)
    def _small_shards(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(module, "SHARD_POSES", 4)

    def test_an_interrupted_simulation_goes_on_where_it_was(
        self, some: Poses, avatars: list[Avatar], tmp_path: Path
    ) -> None:
        first, second = Noted(stop_after=2), Noted()
        with pytest.raises(InterruptedError):
            drawn(some, avatars, workers=first, folder=tmp_path)
        resumed = drawn(some, avatars, workers=second, folder=tmp_path)
        assert (len(first.files), len(second.files)) == (2, 4)
        assert not set(first.files) & set(second.files)
        assert_same(resumed, drawn(some, avatars))

    def test_other_inputs_are_other_files(
        self, some: Poses, avatars: list[Avatar], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def asked(avatars: list[Avatar], **settings: int) -> set[Path]:
            workers = Noted()
            simulate(
                some, avatars, **{"bodies": 1, "views": 2, "seed": 5, **settings},  # type: ignore[arg-type]
                workers=workers, folder=tmp_path,
            )  # fmt: skip
            return set(workers.files)

        taller = [dataclasses.replace(a, vertices=a.vertices * 1.01) for a in avatars]
        files = [asked(avatars), asked(avatars, seed=6), asked(avatars, views=3), asked(taller)]
        monkeypatch.setattr(shard_files, "code_version", lambda: "another")
        monkeypatch.setattr(module, "code_version", lambda: "another")
        files.append(asked(avatars))
        assert len(set.union(*files)) == sum(map(len, files)) == 5 * 6

    def test_what_was_never_finished_is_not_read(
        self, some: Poses, avatars: list[Avatar], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def killed(self: Path, target: Path) -> None:
            raise InterruptedError

        write_avatars(avatars, tmp_path)
        with monkeypatch.context() as patched:
            patched.setattr(Path, "replace", killed)
            patched.setattr(Path, "unlink", lambda self, missing_ok: None)
            with pytest.raises(InterruptedError):
                drawn(some, avatars, workers=Noted(), folder=tmp_path)
        assert len(list(tmp_path.glob(".unfinished-*"))) == 1
        workers = Noted()
        assert_same(drawn(some, avatars, workers=workers, folder=tmp_path), drawn(some, avatars))
        assert len(workers.files) == 6

    def test_a_damaged_shard_is_named(
        self, some: Poses, avatars: list[Avatar], tmp_path: Path
    ) -> None:
        workers = Noted()
        drawn(some, avatars, workers=workers, folder=tmp_path)
        content = bytearray(workers.files[3].read_bytes())
        content[len(content) // 2] ^= 1
        workers.files[3].write_bytes(content)
        with pytest.raises(ShardError, match=f"{workers.files[3].name} is damaged"):
            drawn(some, avatars, folder=tmp_path)

    def test_a_worker_that_writes_elsewhere_is_told(
        self, some: Poses, avatars: list[Avatar], tmp_path: Path
    ) -> None:
        class Elsewhere(Threads):
            def map(self, perform: object, tasks: Iterable[AnyTask]) -> Iterator[int]:  # type: ignore[override]
                for task in tasks:
                    assert isinstance(task, Task)
                    yield len(task.shard)

        with pytest.raises(ShardError, match="is missing: the folder of the shards must be shared"):
            drawn(some, avatars, workers=Elsewhere(), folder=tmp_path)


class TestPerform:
    @pytest.fixture
    def task(self, some: Poses, avatars: list[Avatar], tmp_path: Path) -> Task:
        workers = Noted()
        drawn(some, avatars, workers=workers, folder=tmp_path)
        file, code = write_avatars(avatars, tmp_path), code_version()
        name = name_of(workers.shards[0], file, code)
        assert (tmp_path / name).resolve() == workers.files[0]
        return Task(workers.shards[0], file, tmp_path / name, code)

    def test_writes_the_same_bytes_again(self, task: Task) -> None:
        before = task.file.read_bytes()
        task.file.unlink()
        assert shard_files.perform(task) == len(task.shard)
        assert task.file.read_bytes() == before

    def test_refuses_other_code(self, task: Task) -> None:
        task.file.unlink()
        with pytest.raises(ShardError, match=r"other code .* than this build \(old\)"):
            shard_files.perform(dataclasses.replace(task, code="old"))
        assert not task.file.exists()

    def test_says_where_the_folder_is_not_shared(self, task: Task, tmp_path: Path) -> None:
        missing = dataclasses.replace(task, avatars=tmp_path / "none" / task.avatars.name)
        with pytest.raises(ShardError, match="must be shared by all"):
            shard_files.perform(missing)


def test_code_version_is_that_of_the_sources(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for package in ("descriptor", "index"):
        shutil.copytree(shard_files._PACKAGES / package, tmp_path / package,
                        ignore=shutil.ignore_patterns("data", "__pycache__"))  # fmt: skip
    monkeypatch.setattr(shard_files, "_PACKAGES", tmp_path)
    assert code_version.__wrapped__() == code_version()
    source = tmp_path / "index" / "build" / "render.py"
    source.write_text(source.read_text() + "\n")
    assert code_version.__wrapped__() != code_version()
