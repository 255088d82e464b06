"""Shards: cut anywhere they give the same bytes, and none is rendered twice."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Callable
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from index.build import shard_files
from index.build import simulate as module
from index.build.body import Avatar
from index.build.parameters import RENDERING
from index.build.poses import Poses, merged
from index.build.shard_files import (
    ShardError,
    code_version,
    render_shard,
    shard_name,
    write_avatars,
)
from index.build.simulate import Simulation, simulate
from index.build.views import Shard
from tests.index.build.test_simulate import assert_same

Task = tuple[Shard, Path, Path, str]


class Inline(Executor):
    """Executor of this thread that records its calls, and fails after some."""

    def __init__(self, stop_after: int | None = None, call: bool = True) -> None:
        self.calls: list[Task] = []
        self._stop_after, self._call = stop_after, call

    @property
    def files(self) -> list[Path]:
        return [file for _, _, file, _ in self.calls]

    def submit(self, function: Callable[..., Any], /, *task: Any) -> Future[Any]:  # type: ignore[override]
        if len(self.calls) == self._stop_after:
            raise InterruptedError
        self.calls.append(task)  # type: ignore[arg-type]
        future: Future[Any] = Future()
        future.set_result(function(*task) if self._call else len(task[0]))
        return future


@pytest.fixture(scope="module")
def some(poses: Poses, laid: Poses) -> Poses:
    """Recorded and laid-down poses, mixed."""
    return merged([poses.take(np.arange(0, 14)), laid.take(np.arange(6)), poses.take([20, 47])])


def rendered(some: Poses, avatars: list[Avatar], **settings: object) -> Simulation:
    return simulate(
        some, avatars, bodies=2, views=3, seed=5, only_new=True, **settings  # type: ignore[arg-type]
    )  # fmt: skip


@pytest.mark.parametrize("size", [1, 2, 5, 21, 22, 23])
def test_same_bytes_in_shards_of_any_size(
    some: Poses, avatars: list[Avatar], size: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert len(some) == 22
    whole = rendered(some, avatars)
    monkeypatch.setattr(module, "RENDERING", dataclasses.replace(RENDERING, shard_poses=size))
    executor = Inline()
    assert_same(rendered(some, avatars, executor=executor), whole)
    assert len(executor.files) == -(-22 // size)


class TestResume:
    @pytest.fixture(autouse=True)
    def _small_shards(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(module, "RENDERING", dataclasses.replace(RENDERING, shard_poses=4))

    def test_an_interrupted_simulation_is_resumed(
        self, some: Poses, avatars: list[Avatar], tmp_path: Path
    ) -> None:
        first, second = Inline(stop_after=2), Inline()
        with pytest.raises(InterruptedError):
            rendered(some, avatars, executor=first, folder=tmp_path)
        resumed = rendered(some, avatars, executor=second, folder=tmp_path)
        assert (len(first.files), len(second.files)) == (2, 4)
        assert not set(first.files) & set(second.files)
        assert_same(resumed, rendered(some, avatars))

    def test_other_inputs_are_other_files(
        self, some: Poses, avatars: list[Avatar], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def files_of(avatars: list[Avatar], **settings: int) -> set[Path]:
            executor = Inline()
            simulate(
                some, avatars, **{"bodies": 1, "views": 2, "seed": 5, **settings},  # type: ignore[arg-type]
                executor=executor, folder=tmp_path,
            )  # fmt: skip
            return set(executor.files)

        taller = [dataclasses.replace(a, vertices=a.vertices * 1.01) for a in avatars]
        files = [
            files_of(avatars),
            files_of(avatars, seed=6),
            files_of(avatars, views=3),
            files_of(taller),
        ]
        monkeypatch.setattr(shard_files, "code_version", lambda: "another")
        monkeypatch.setattr(module, "code_version", lambda: "another")
        files.append(files_of(avatars))
        assert len(set.union(*files)) == sum(map(len, files)) == 5 * 6

    def test_an_unfinished_file_is_not_read(
        self, some: Poses, avatars: list[Avatar], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def killed(self: Path, target: Path) -> None:
            raise InterruptedError

        write_avatars(avatars, tmp_path)
        with monkeypatch.context() as patched:
            patched.setattr(Path, "replace", killed)
            patched.setattr(Path, "unlink", lambda self, missing_ok: None)
            with pytest.raises(InterruptedError):
                rendered(some, avatars, executor=Inline(), folder=tmp_path)
        assert len(list(tmp_path.glob(".unfinished-*"))) == 1
        executor = Inline()
        assert_same(
            rendered(some, avatars, executor=executor, folder=tmp_path), rendered(some, avatars)
        )
        assert len(executor.files) == 6

    def test_a_damaged_shard_is_named(
        self, some: Poses, avatars: list[Avatar], tmp_path: Path
    ) -> None:
        executor = Inline()
        rendered(some, avatars, executor=executor, folder=tmp_path)
        content = bytearray(executor.files[3].read_bytes())
        content[len(content) // 2] ^= 1
        executor.files[3].write_bytes(content)
        with pytest.raises(ShardError, match=f"{executor.files[3].name} is damaged"):
            rendered(some, avatars, folder=tmp_path)

    def test_a_shard_written_elsewhere_is_missing(
        self, some: Poses, avatars: list[Avatar], tmp_path: Path
    ) -> None:
        with pytest.raises(ShardError, match="is missing: the folder of the shards must be shared"):
            rendered(some, avatars, executor=Inline(call=False), folder=tmp_path)


class TestRenderShard:
    @pytest.fixture
    def task(self, some: Poses, avatars: list[Avatar], tmp_path: Path) -> Task:
        executor = Inline()
        rendered(some, avatars, executor=executor, folder=tmp_path)
        shard, file, path, _ = executor.calls[0]
        assert file == write_avatars(avatars, tmp_path)
        assert path == tmp_path / shard_name(shard, file, code_version())
        return executor.calls[0]

    def test_writes_the_same_bytes_again(self, task: Task) -> None:
        shard, _, file, _ = task
        before = file.read_bytes()
        file.unlink()
        assert render_shard(*task) == len(shard)
        assert file.read_bytes() == before

    def test_refuses_other_code(self, task: Task) -> None:
        shard, avatars, file, _ = task
        file.unlink()
        with pytest.raises(ShardError, match=r"other code .* than this build \(old\)"):
            render_shard(shard, avatars, file, "old")
        assert not file.exists()

    def test_reports_a_folder_that_is_not_shared(self, task: Task, tmp_path: Path) -> None:
        shard, avatars, file, code = task
        with pytest.raises(ShardError, match="must be shared by all"):
            render_shard(shard, tmp_path / "none" / avatars.name, file, code)


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
