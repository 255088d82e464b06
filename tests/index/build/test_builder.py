"""The whole line, on toys and, slowly, from the shared motion capture."""

from __future__ import annotations

import importlib.util
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from index.build.builder import Plan, split_by_clip
from index.build.motion import Segment
from index.store import PoseIndex

ROOT = Path(__file__).resolve().parents[3]


class TestPlan:
    def test_counts_poses_for_the_wanted_entries(self) -> None:
        # Each pose comes on each body from each view.
        assert Plan(entries=2400, bodies=2, views=12).poses == 100

    @pytest.mark.parametrize(("frames", "bodies"), [(1000, 1), (100, 1), (99, 2), (50, 2), (30, 4)])
    def test_spends_on_bodies_what_it_lacks_in_frames(self, frames: int, bodies: int) -> None:
        plan = Plan(entries=1200, bodies=1, views=12).fitted(frames)
        assert plan.bodies == bodies
        assert plan.poses <= frames

    def test_refuses_fewer_entries_than_one_pose_makes(self) -> None:
        with pytest.raises(ValueError, match="expected at least 24 entries, got 23"):
            Plan(entries=23, bodies=2, views=12)

    def test_refuses_an_unknown_descriptor(self) -> None:
        with pytest.raises(ValueError, match="got 'hog'"):
            Plan(descriptor="hog")


class TestSplitByClip:
    segments = tuple(
        Segment(f"{action}_{n}", "s", action, 0, 9)
        for action, clips in (("walk", 12), ("jump", 4), ("golf", 1))
        for n in range(clips)
    )

    def test_no_clip_in_both_and_none_lost(self) -> None:
        kept, held = split_by_clip(self.segments)
        assert not {s.clip for s in kept} & {s.clip for s in held}
        assert sorted(map(repr, kept + held)) == sorted(map(repr, self.segments))

    def test_every_action_stays_among_the_kept(self) -> None:
        kept, held = split_by_clip(self.segments)
        assert {s.action for s in kept} == {"walk", "jump", "golf"}
        assert {s.action for s in held} == {"walk", "jump"}

    def test_a_clip_of_two_actions_is_held_out_whole(self) -> None:
        mixed = [*self.segments, Segment("walk_10", "s", "jump", 9, 20)]
        kept, held = split_by_clip(mixed)
        assert not {s.clip for s in kept} & {s.clip for s in held}


@pytest.fixture
def small_mocap(shared: Path, tmp_path: Path) -> Path:
    """A few short clips of the shared motion capture."""
    if importlib.util.find_spec("anny") is None or importlib.util.find_spec("torch") is None:
        pytest.skip("no body model: the build extra (anny, torch) is not installed")
    folder = tmp_path / "mocap"
    folder.mkdir()
    (folder / "bvh").symlink_to(shared / "mocap" / "bvh")
    lines = (shared / "mocap" / "manifest.csv").read_text().splitlines()
    wanted = ("basketball_train", "jump_train", "03_02", "walk_train")
    rows = [line for line in lines[1:] if line.startswith(wanted)]
    assert len(rows) >= 8
    (folder / "manifest.csv").write_text("\n".join([lines[0], *rows]) + "\n")
    return folder


def build(mocap: Path, out: Path, hash_seed: str = "0") -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "scripts.build_index", "--mocap", mocap, "--out", out,
               "--entries", "480", "--bodies", "1", "--views", "4"]  # fmt: skip
    return subprocess.Popen(
        list(map(str, command)), cwd=ROOT, text=True, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, env={**os.environ, "PYTHONHASHSEED": hash_seed},
    )  # fmt: skip


@pytest.mark.slow
def test_same_inputs_build_the_same_bytes(small_mocap: Path, tmp_path: Path) -> None:
    for name in ("one", "two"):
        process = build(small_mocap, tmp_path / name, hash_seed=str(len(name)))
        printed, complaint = process.communicate(timeout=900)
        assert process.returncode == 0, complaint
        assert "in T-pose" in printed
        assert "entries in" in printed
    one, two = (PoseIndex.load(tmp_path / name) for name in ("one", "two"))
    assert one.version == two.version
    assert len(one) == 480
    assert set(one.actions) == {"basketball", "jump", "walk"}
    for file in (tmp_path / "one").iterdir():
        assert file.read_bytes() == (tmp_path / "two" / file.name).read_bytes()


@pytest.mark.slow
def test_killed_build_leaves_the_old_artefact(
    small_mocap: Path, tmp_path: Path, toy_index: PoseIndex
) -> None:
    version = toy_index.save(tmp_path / "artefact")
    for seconds in (2.0, 8.0):
        process = build(small_mocap, tmp_path / "artefact")
        time.sleep(seconds)
        process.send_signal(signal.SIGKILL)
        process.communicate()
        assert process.returncode == -signal.SIGKILL
        assert PoseIndex.load(tmp_path / "artefact").version == version


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spoil", "message"),
    [("manifest", "line 2 of"), ("clip", "jump_train_1"), ("empty", "lists no segment")],
)
def test_bad_input_is_one_sentence_and_leaves_nothing(
    small_mocap: Path, tmp_path: Path, spoil: str, message: str
) -> None:
    manifest = small_mocap / "manifest.csv"
    lines = manifest.read_text().splitlines()
    if spoil == "manifest":
        manifest.write_text("\n".join([lines[0], "x,1,walk,9,3,30,", *lines[1:]]))
    elif spoil == "empty":
        manifest.write_text(lines[0] + "\n")
    else:
        folder = small_mocap / "bvh"
        real = folder.resolve()
        folder.unlink()
        folder.mkdir()
        for file in real.glob("*_train_*.bvh"):
            (folder / file.name).write_bytes(file.read_bytes())
        (folder / "03_02.bvh").write_bytes((real / "03_02.bvh").read_bytes())
        (folder / "jump_train_1.bvh").write_text("HIERARCHY\n")
    process = build(small_mocap, tmp_path / "out" / "artefact")
    _, complaint = process.communicate(timeout=300)
    assert process.returncode == 1
    assert complaint.count("\n") == 1
    assert complaint.startswith("build_index: ")
    assert message in complaint
    assert not (tmp_path / "out").exists()
