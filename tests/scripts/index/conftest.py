"""A small body on a small skeleton, moved by a few clips, and indexes of what it does.

Everything runs through the real simulation; only the body and the motion are toys, so that
neither torch nor shared data are needed.
"""

from pathlib import Path

import numpy as np
import pytest

from descriptor.descriptor import DiagonalDescriptor
from index.artefact import load_index
from index.confidence import Calibration
from index.network import RankingModel
from index.search import ExactNeighbours
from index.store import PoseIndex
from scripts.index.body import Avatar
from scripts.index.motion import Segment
from scripts.index.poses import Poses, lay_down, merged, read_poses
from scripts.index.simulate import Simulation, simulate
from scripts.index.writer import save_index
from tests.conftest import INDEXES, SHARED
from tests.index.helpers import random_reranker
from tests.scripts.index.toys import box_avatar, walk, write_clip


@pytest.fixture(scope="session")
def motion_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A motion folder with two clips: ``stroll`` (walk) and ``greet`` (wave)."""
    folder = tmp_path_factory.mktemp("mocap")
    write_clip(folder / "bvh" / "stroll.bvh", walk(30))
    write_clip(folder / "bvh" / "greet.bvh", walk(20, lift=140))
    (folder / "manifest.csv").write_text(
        "clip,subject,action,start_frame,end_frame,fps,description\n"
        "stroll,s1,walk,0,30,30,\n"
        "greet,s2,wave,2,20,30,lifts an arm\n"
    )
    return folder


SEGMENTS = (Segment("stroll", "s1", "walk", 0, 30), Segment("greet", "s2", "wave", 2, 20))


@pytest.fixture(scope="session")
def poses(motion_folder: Path) -> Poses:
    """All 48 sound frames of the motion folder."""
    return read_poses(motion_folder, SEGMENTS)[0]


@pytest.fixture(scope="session")
def avatars() -> list[Avatar]:
    """A slim and a broad box body."""
    return [box_avatar("slim", 0.9, 0.97), box_avatar("broad", 1.2)]


@pytest.fixture(scope="session")
def simulation(poses: Poses, avatars: list[Avatar]) -> Simulation:
    """All poses, one body each, twelve views: 576 entries."""
    return simulate(poses, avatars, bodies=1, views=12, seed=7)


def index_of(simulation: Simulation, name: str = "toy") -> PoseIndex:
    """An index over a simulation, by the paper's descriptor, uncalibrated."""
    descriptor = DiagonalDescriptor()
    return PoseIndex(
        name=name,
        descriptor=descriptor,
        vectors=ExactNeighbours(simulation.describe(descriptor)),
        entries=simulation.entries,
        skeletons=simulation.skeletons,
        skeleton_labels=simulation.skeleton_labels,
        clips=simulation.clips,
        subjects=simulation.subjects,
        actions=simulation.actions,
        silhouette_store=simulation.silhouette_store,
        parameters={"confidence": Calibration.none().parameters()},
    )


@pytest.fixture(scope="session")
def body_index(simulation: Simulation) -> PoseIndex:
    """An index of 576 silhouettes of box bodies."""
    return index_of(simulation)


@pytest.fixture(scope="session")
def toy_index() -> PoseIndex:
    """576 silhouettes of moving figures."""
    return load_index(INDEXES / "toy")


@pytest.fixture
def saved(toy_index: PoseIndex, tmp_path: Path) -> Path:
    """The index of moving figures, stored."""
    folder = tmp_path / "artefact"
    save_index(toy_index, folder)
    return folder


@pytest.fixture(scope="session")
def reranker() -> RankingModel:
    return random_reranker()


@pytest.fixture(scope="session")
def laid(poses: Poses, avatars: list[Avatar]) -> Poses:
    """The poses that lie well enough, laid down."""
    return lay_down(poses, avatars[0], len(poses), seed=0)


@pytest.fixture(scope="session")
def ground_simulation(poses: Poses, laid: Poses, avatars: list[Avatar]) -> Simulation:
    """Every fourth pose as recorded, then those laid down; twelve views each."""
    return simulate(
        merged([poses.take(np.arange(0, len(poses), 4)), laid]), avatars, bodies=1, views=12, seed=8
    )


@pytest.fixture(scope="session")
def ground_index(ground_simulation: Simulation) -> PoseIndex:
    """An index of box bodies, most of them lying: wide ones were rolled."""
    return index_of(ground_simulation, "ground")


@pytest.fixture(scope="session")
def shared() -> Path:
    """The project's shared data; tests that need it skip where it is not."""
    if not (SHARED / "mocap" / "manifest.csv").is_file():
        pytest.skip(f"no shared data at {SHARED}; set SHARED to its path")
    return SHARED
