"""The whole line, on toys and, slowly, from the shared motion capture."""

import importlib.util
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from index.artefact import load_index
from index.posture import LOW, POSTURES, classify_postures
from scripts.index.body import Avatar
from scripts.index.builder import (
    LAID_DOWN_SHARE,
    LOW_SHARE,
    Plan,
    QueryCounts,
    choose_poses,
    entries_of,
    simulate_queries,
    split,
    split_by_clip,
    spread,
)
from scripts.index.motion import MANIFESTS, Segment, read_manifest
from scripts.index.poses import LYING_SIDES, Poses, joints_of, read_poses
from scripts.index.simulate import Simulation
from tests.scripts.index.toys import walk, write_clip
from tests.support.programs import output_of


class TestPlan:
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

    def test_actions_of_each_manifest_are_held_out_by_themselves(self) -> None:
        ground = [Segment(f"g{n}", "s", "walk", 0, 9, MANIFESTS[1]) for n in range(5)]
        _, held = split_by_clip([*self.segments, *ground])
        assert [s.clip for s in held if s.manifest == MANIFESTS[1]] == ["g2"]
        _, without = split_by_clip(self.segments)
        assert [s for s in held if s.manifest == MANIFESTS[0]] == without


class TestSplit:
    def test_clips_of_their_own_where_there_are_enough(self) -> None:
        *parts, honest = split(TestSplitByClip.segments)
        assert honest
        assert tuple(parts) == split_by_clip(TestSplitByClip.segments)

    def test_the_ends_of_clips_where_there_are_too_few(self) -> None:
        few = [Segment("a", "s", "walk", 10, 110), Segment("b", "s", "jump", 0, 2)]
        kept, held, honest = split(few)
        assert not honest
        assert [(s.clip, s.start, s.end) for s in kept] == [("a", 10, 76), ("b", 0, 1)]
        assert [(s.clip, s.start, s.end) for s in held] == [("a", 85, 110)]

    def test_entries_are_those_of_the_frames(self, simulation: Simulation) -> None:
        rows = entries_of(simulation, [Segment("stroll", "s1", "walk", 3, 7)])
        labels = simulation.skeleton_labels[simulation.entries["skeleton"][rows]]
        assert {simulation.clips[clip] for clip in labels["clip"]} == {"stroll"}
        assert sorted(set(labels["frame"].tolist())) == [3, 4, 5, 6]
        clips = [Segment(clip, "s", "walk", 0, 99) for clip in simulation.clips]
        assert len(entries_of(simulation, clips)) == len(simulation)
        assert len(entries_of(simulation, [Segment("ghost", "s", "walk", 0, 9)])) == 0


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

    def test_so_has_each_beginning(self, pool: Poses, avatars: list[Avatar]) -> None:
        groups = self.groups(choose_poses(pool, avatars[0], 50, seed=0), avatars[0])
        for end in range(len(groups) + 1):
            for group in ("laid", "low", "upright"):
                share = groups.count(group) / len(groups)
                assert abs(groups[:end].count(group) - share * end) <= 1

    def test_no_pose_comes_twice(self, pool: Poses, avatars: list[Avatar]) -> None:
        chosen = choose_poses(pool, avatars[0], 50, seed=0)
        kept = np.isnan(chosen.lying_deg)
        for rows in (kept, ~kept):
            pairs = list(zip(chosen.clip[rows], chosen.frame[rows], strict=True))
            assert len(set(pairs)) == len(pairs)

    def test_where_nobody_is_low_more_are_upright(
        self, poses: Poses, avatars: list[Avatar]
    ) -> None:
        groups = self.groups(choose_poses(poses, avatars[0], 20, seed=0), avatars[0])
        laid = round(LAID_DOWN_SHARE * 20)
        assert (groups.count("laid"), groups.count("upright")) == (laid, 20 - laid)


class TestSimulateQueries:
    def test_asks_for_frames_of_both_manifests_and_laid_down(
        self, ground_motion: Path, avatars: list[Avatar]
    ) -> None:
        segments = read_manifest(ground_motion)
        asked = QueryCounts(upright=12, near_ground=5, laid_down=4)
        queries = simulate_queries(ground_motion, segments, avatars, asked, seed=1)
        labels = queries.skeleton_labels
        actions = [queries.actions[action] for action in labels["action"]]
        assert set(actions[:12]) == {"walk", "wave"}
        assert actions[12:17] == ["sit"] * 5
        assert all(action.startswith("lie-on-") for action in actions[17:])
        # Each from one view.
        assert_array_equal(queries.entries["skeleton"], np.arange(21))


@pytest.mark.parametrize("count", [0, 1, 7, 48, 60])
def test_spread_takes_poses_evenly_and_none_twice(poses: Poses, count: int) -> None:
    rows = spread(poses, count)
    assert len(rows) == min(count, len(poses))
    numbers = 100 * rows.clip + rows.frame
    assert (np.diff(numbers) > 0).all()


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
