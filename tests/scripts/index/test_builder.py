"""The whole line, on toys and, slowly, from the shared motion capture."""

import importlib.util
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from index.artefact import load_index
from index.posture import LOW, POSTURES, classify_postures
from scripts.index.body import Avatar
from scripts.index.builder import (
    LAID_DOWN_SHARE,
    LOW_SHARE,
    Plan,
    choose_poses,
    split,
    split_by_clip,
)
from scripts.index.motion import MANIFESTS, Segment, read_manifest
from scripts.index.poses import LYING_SIDES, Poses, joints_of, read_poses
from tests.scripts.index.toys import walk, write_clip
from tests.support.programs import output_of


class TestPlan:
    @pytest.mark.parametrize(("frames", "bodies"), [(1000, 1), (100, 1), (99, 2), (50, 2), (30, 4)])
    def test_spends_on_bodies_what_it_lacks_in_frames(self, frames: int, bodies: int) -> None:
        plan = Plan(entries=1200, bodies=1, views=12).fitted(frames)
        assert plan.bodies == bodies
        assert plan.poses <= frames


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


class TestSplit:
    def test_the_ends_of_clips_where_there_are_too_few(self) -> None:
        few = [Segment("a", "s", "walk", 10, 110), Segment("b", "s", "jump", 0, 2)]
        kept, held, honest = split(few)
        assert not honest
        assert [(s.clip, s.start, s.end) for s in kept] == [("a", 10, 76), ("b", 0, 1)]
        assert [(s.clip, s.start, s.end) for s in held] == [("a", 85, 110)]


@pytest.fixture(scope="module")
def ground_motion(motion_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The motion folder with a second manifest, of a person who sits."""
    folder = tmp_path_factory.mktemp("ground") / "mocap"
    shutil.copytree(motion_folder, folder)
    legs = {"LeftLeg": (0.0, 0.0, 80.0), "RightLeg": (0.0, 0.0, 80.0)}
    seated = [
        {**frame, **legs, "LeftUpLeg": (-15.0, 0.0, thigh), "RightUpLeg": (15.0, 0.0, thigh)}
        for frame, thigh in zip(walk(30), np.linspace(-85, -75, 30).tolist(), strict=True)
    ]
    write_clip(folder / "bvh" / "rest.bvh", seated)
    (folder / MANIFESTS[1]).write_text(
        "clip,subject,action,start_frame,end_frame,fps,description\nrest,s3,sit,0,30,30,\n"
    )
    return folder


@pytest.fixture(scope="module")
def pool(ground_motion: Path) -> Poses:
    """78 frames; in 30 the person sits."""
    return read_poses(ground_motion, read_manifest(ground_motion))[0]


class TestChoosePoses:
    def groups(self, poses: Poses, avatar: Avatar) -> list[str]:
        postures = classify_postures(joints_of(poses, avatar), (0.0, 1.0, 0.0))
        return [
            "laid" if not np.isnan(angle) else "low" if POSTURES[row] in LOW else "upright"
            for angle, row in zip(poses.lying_deg, postures, strict=True)
        ]

    @pytest.mark.parametrize("count", [5, 20, 50])
    def test_each_group_has_its_share(self, pool: Poses, avatars: list[Avatar], count: int) -> None:
        groups = self.groups(choose_poses(pool, avatars[0], count, seed=0), avatars[0])
        assert len(groups) == count
        assert groups.count("laid") == round(LAID_DOWN_SHARE * count)
        assert groups.count("low") == round(LOW_SHARE * count)


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


@pytest.mark.slow
def test_same_inputs_build_the_same_bytes(small_mocap: Path, tmp_path: Path) -> None:
    # An index is called after its folder.
    folders = [tmp_path / parent / "index" for parent in ("one", "two")]
    for seed, folder in enumerate(folders):
        folder.parent.mkdir()
        printed = output_of(
            sys.executable, "-m", "scripts", "build", "--mocap", small_mocap, "--out", folder,
            "--entries", "480", "--bodies", "1", "--views", "4", PYTHONHASHSEED=str(seed),
        )  # fmt: skip
        assert "in T-pose" in printed
        assert "entries in" in printed
    one, two = (load_index(folder) for folder in folders)
    assert one.version == two.version
    assert len(one) == 480
    laid_down = {f"lie-on-{side}" for side in LYING_SIDES}
    assert set(one.actions) == {"basketball", "jump", "walk"} | laid_down
    for file in folders[0].iterdir():
        assert file.read_bytes() == (folders[1] / file.name).read_bytes()
