"""The artefact: the same on disk as in memory, or refused in one sentence."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import lzma
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import faiss
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from descriptor.descriptor import DiscriminantDescriptor
from descriptor.silhouette import normalise
from index import folders, store
from index.artefact import ArtefactError, npy_bytes
from index.silhouettes import Silhouettes
from index.skeleton import camera_rotation, mirror_3d, mirror_normalised, project
from index.store import PoseIndex

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def saved(toy_index: PoseIndex, tmp_path: Path) -> Path:
    folder = tmp_path / "artefact"
    toy_index.save(folder)
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in folder.iterdir()}


def seal(folder: Path, change: Callable[[dict[str, object]], object]) -> None:
    """Change the manifest and give it the content hash that fits."""
    file = folder / "manifest.json"
    manifest = json.loads(file.read_text())
    change(manifest)
    manifest["version"] = store._version(manifest)
    file.write_text(json.dumps(manifest))


class TestRoundTrip:
    def test_loads_what_was_saved(self, toy_index: PoseIndex, saved: Path) -> None:
        back = PoseIndex.load(saved)
        assert back.version.startswith("sha256:")
        for field in ("name", "clips", "subjects", "actions", "parameters", "descriptor"):
            assert getattr(back, field) == getattr(toy_index, field)
        for field in ("vectors", "entries", "skeletons", "skeleton_labels"):
            assert_array_equal(getattr(back, field), getattr(toy_index, field))
        everything = np.arange(len(toy_index))
        assert_array_equal(back.silhouettes(everything), toy_index.silhouettes(everything))

    def test_learned_descriptors_travel_with_the_index(
        self, toy_index: PoseIndex, tmp_path: Path
    ) -> None:
        projection = np.random.default_rng(0).normal(size=(6, 28, 14)).astype(np.float32)
        projection[:4, :, 1::2] = 0
        projection[4:, :, 0::2] = 0
        learned = DiscriminantDescriptor(projection.reshape(6, -1))
        silhouettes = toy_index.silhouettes(np.arange(len(toy_index)))
        index = dataclasses.replace(
            toy_index, descriptor=learned, vectors=learned.describe(silhouettes)
        )
        index.save(tmp_path / "learned")
        back = PoseIndex.load(tmp_path / "learned")
        assert_array_equal(back.descriptor.describe(silhouettes), index.vectors)
        assert_array_equal(back.descriptor.mirror(index.vectors), learned.mirror(index.vectors))

    def test_same_index_twice_gives_the_same_bytes(
        self, toy_index: PoseIndex, saved: Path, tmp_path: Path
    ) -> None:
        version = toy_index.save(tmp_path / "again")
        assert contents(tmp_path / "again") == contents(saved)
        assert PoseIndex.load(saved).version == version

    def test_saving_a_loaded_index_gives_the_same_bytes(self, saved: Path, tmp_path: Path) -> None:
        PoseIndex.load(saved).save(tmp_path / "copy")
        assert contents(tmp_path / "copy") == contents(saved)

    @pytest.mark.parametrize("field", ["name", "parameters", "vectors", "skeletons", "actions"])
    def test_any_change_of_content_changes_the_version(
        self, toy_index: PoseIndex, tmp_path: Path, field: str
    ) -> None:
        changed = {
            "name": "other",
            "parameters": {**toy_index.parameters, "seed": 8},
            "vectors": toy_index.vectors + np.float32(1e-3),
            "skeletons": toy_index.skeletons + np.float16(0.01),
            "actions": tuple(reversed(toy_index.actions)),
        }[field]
        other = dataclasses.replace(toy_index, **{field: changed})
        assert other.save(tmp_path / "b") != toy_index.save(tmp_path / "a")

    def test_replaces_an_older_artefact_whole(self, toy_index: PoseIndex, saved: Path) -> None:
        (saved / "left-over").write_text("from another format")
        dataclasses.replace(toy_index, name="newer").save(saved)
        assert PoseIndex.load(saved).name == "newer"
        assert not (saved / "left-over").exists()
        assert [p.name for p in saved.parent.iterdir()] == [saved.name]


class TestFailedSave:
    def test_leaves_nothing_behind(
        self, toy_index: PoseIndex, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(Path, "write_text", _full_disk)
        with pytest.raises(OSError, match="No space left"):
            toy_index.save(tmp_path / "artefact")
        assert list(tmp_path.iterdir()) == []

    def test_keeps_the_old_artefact(
        self, toy_index: PoseIndex, saved: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        before = contents(saved)
        monkeypatch.setattr(Path, "write_bytes", _full_disk)
        with pytest.raises(OSError, match="No space left"):
            dataclasses.replace(toy_index, name="newer").save(saved)
        assert contents(saved) == before
        assert [p.name for p in saved.parent.iterdir()] == [saved.name]

    def test_keeps_the_old_artefact_when_the_last_rename_fails(
        self, toy_index: PoseIndex, saved: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        before = contents(saved)
        rename = Path.rename
        monkeypatch.setattr(folders, "_exchange", lambda *_: False)

        def fail_for_the_new(self: Path, target: Path) -> Path:
            if target == saved and self.parent == saved.parent:
                raise OSError(5, "Input/output error")
            return rename(self, target)

        monkeypatch.setattr(Path, "rename", fail_for_the_new)
        with pytest.raises(OSError, match="Input/output error"):
            dataclasses.replace(toy_index, name="newer").save(saved)
        assert contents(saved) == before

    def test_killed_while_writing_keeps_the_old_artefact(
        self, toy_index: PoseIndex, saved: Path
    ) -> None:
        # The manifest is written last: the process dies with every other file in place.
        script = f"""
import dataclasses, os, pathlib, signal
from index.store import PoseIndex
index = PoseIndex.load({str(saved)!r})
pathlib.Path.write_text = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
dataclasses.replace(index, name="newer").save({str(saved)!r})
"""
        before = contents(saved)
        ended = subprocess.run([sys.executable, "-c", script], cwd=ROOT, check=False)
        assert ended.returncode == -signal.SIGKILL
        assert contents(saved) == before
        dataclasses.replace(toy_index, name="newer").save(saved)
        assert PoseIndex.load(saved).name == "newer"
        # What the killed one left is gone too.
        assert [p.name for p in saved.parent.iterdir()] == [saved.name]

    def test_folders_that_cannot_be_exchanged_are_replaced_in_two_steps(
        self, toy_index: PoseIndex, saved: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(folders, "_exchange", lambda *_: False)
        dataclasses.replace(toy_index, name="newer").save(saved)
        assert PoseIndex.load(saved).name == "newer"
        assert [p.name for p in saved.parent.iterdir()] == [saved.name]

    def test_another_save_that_is_under_way_keeps_its_files(
        self, toy_index: PoseIndex, saved: Path
    ) -> None:
        staging = saved.parent / f".{saved.name}-other"
        staging.mkdir()
        held = folders.lock(staging)
        toy_index.save(saved)
        assert staging.exists()
        assert held is not None
        os.close(held)
        toy_index.save(saved)
        assert not staging.exists()


def _full_disk(*_: object) -> None:
    raise OSError(28, "No space left on device")


class TestRefusal:
    """One sentence that names the file and the fault."""

    def refused(self, folder: Path) -> str:
        with pytest.raises(ArtefactError) as caught:
            PoseIndex.load(folder)
        message = str(caught.value)
        assert str(folder) in message
        assert "\n" not in message
        return message

    def test_missing_folder(self, tmp_path: Path) -> None:
        assert "there is no index at" in self.refused(tmp_path / "nowhere")

    def test_folder_without_manifest(self, tmp_path: Path) -> None:
        assert "manifest.json is missing" in self.refused(tmp_path)

    def test_every_file_truncated(self, saved: Path) -> None:
        for file in sorted(saved.glob("*.*")):
            whole = file.read_bytes()
            file.write_bytes(whole[: len(whole) // 2])
            message = self.refused(saved)
            assert file.name in message
            assert "unreadable" in message or "truncated" in message
            file.write_bytes(whole)
        PoseIndex.load(saved)

    def test_every_file_altered_by_one_bit(self, saved: Path) -> None:
        for file in sorted(saved.glob("*.*")):
            if file.name == "manifest.json":
                continue
            whole = bytearray(file.read_bytes())
            whole[-1] ^= 1
            file.write_bytes(whole)
            message = self.refused(saved)
            assert file.name in message
            assert "altered" in message
            whole[-1] ^= 1
            file.write_bytes(whole)
        PoseIndex.load(saved)

    def test_every_file_missing(self, saved: Path) -> None:
        for file in sorted(saved.glob("*.*")):
            file.rename(saved.parent / file.name)
            assert file.name in self.refused(saved)
            (saved.parent / file.name).rename(file)

    def test_altered_manifest(self, saved: Path) -> None:
        file = saved / "manifest.json"
        file.write_text(file.read_text().replace('"toy"', '"TOY"'))
        assert "was altered: its content hash does not fit" in self.refused(saved)

    @pytest.mark.parametrize("text", ["[]", '"pose"', "{}", '{"name": "mnist"}'])
    def test_foreign_json(self, saved: Path, text: str) -> None:
        (saved / "manifest.json").write_text(text)
        assert "is not the manifest of a pose index" in self.refused(saved)

    @pytest.mark.parametrize("content", [b"", b"{", b"\x80\x02}q\x00.", b"\xff\xfe"])
    def test_manifest_that_is_no_json(self, saved: Path, content: bytes) -> None:
        (saved / "manifest.json").write_bytes(content)
        assert "is unreadable" in self.refused(saved)

    @pytest.mark.parametrize("number", [0, store.FORMAT_VERSION + 1, "1"])
    def test_another_format(self, saved: Path, number: object) -> None:
        seal(saved, lambda manifest: manifest.update(format_version=number))
        assert f"this service reads format {store.FORMAT_VERSION}" in self.refused(saved)

    def test_other_joints(self, saved: Path) -> None:
        seal(saved, lambda manifest: manifest.update(joints=["nose"]))
        assert "another set of joints" in self.refused(saved)

    def test_unknown_descriptor(self, saved: Path) -> None:
        seal(saved, lambda manifest: manifest.update(descriptor={"name": "hu"}))
        assert "descriptor" in self.refused(saved)

    @pytest.mark.parametrize("key", ["files", "descriptor", "clips", "parameters"])
    def test_sealed_manifest_that_lacks_something(self, saved: Path, key: str) -> None:
        seal(saved, lambda manifest: manifest.pop(key))
        assert key in self.refused(saved)

    def test_sealed_files_that_do_not_fit_each_other(
        self, toy_index: PoseIndex, saved: Path
    ) -> None:
        half = npy_bytes(toy_index.entries[: len(toy_index) // 2])
        (saved / "entries.npy.xz").write_bytes(lzma.compress(half))
        digest = hashlib.sha256(half).hexdigest()
        seal(
            saved,
            lambda manifest: manifest["files"].update(  # type: ignore[attr-defined]
                {"entries.npy": digest}
            ),
        )
        assert "does not hold together" in self.refused(saved)

    def test_another_kind_of_faiss_index(self, toy_index: PoseIndex, saved: Path) -> None:
        other = faiss.IndexFlatIP(toy_index.descriptor.dimension)
        other.add(toy_index.vectors)
        content = faiss.serialize_index(other).tobytes()
        (saved / "descriptors.faiss.xz").write_bytes(lzma.compress(content))
        digest = hashlib.sha256(content).hexdigest()
        seal(
            saved,
            lambda manifest: manifest["files"].update(  # type: ignore[attr-defined]
                {"descriptors.faiss": digest}
            ),
        )
        assert "expected a FAISS IndexFlatL2, got IndexFlatIP" in self.refused(saved)


class TestConstruction:
    @pytest.mark.parametrize(
        ("field", "value", "message"),
        [
            ("vectors", np.zeros((3, 48), np.float32), r"expected vectors of shape \(576, 48\)"),
            ("skeletons", np.zeros((1, 19, 3), np.float16), "expected skeletons of shape"),
            ("skeletons", np.zeros((1, 24, 3), np.float16), "expected skeletons of shape"),
            (
                "silhouette_store",
                Silhouettes.compress(np.zeros((2, 768), np.uint8)),
                "expected 576 silhouettes, got 2",
            ),
        ],
    )  # fmt: skip
    def test_parts_must_fit(
        self, toy_index: PoseIndex, field: str, value: object, message: str
    ) -> None:
        with pytest.raises(ValueError, match=message):
            dataclasses.replace(toy_index, **{field: value})

    def test_entries_must_name_skeletons(self, toy_index: PoseIndex) -> None:
        with pytest.raises(ValueError, match="expected skeletons below 5, an entry names"):
            dataclasses.replace(
                toy_index,
                skeletons=toy_index.skeletons[:5],
                skeleton_labels=toy_index.skeleton_labels[:5],
            )

    def test_is_never_empty(self, toy_index: PoseIndex) -> None:
        with pytest.raises(ValueError, match="at least one entry"):
            dataclasses.replace(toy_index, entries=toy_index.entries[:0])


class TestSearch:
    def test_equals_brute_force(self, toy_index: PoseIndex) -> None:
        noise = np.random.default_rng(0).normal(0, 0.3, (12, 48)).astype(np.float32)
        queries = toy_index.vectors[:576:48] + noise
        distances, numbers = toy_index.search(queries, 10)
        apart = np.linalg.norm(
            queries[:, None].astype(np.float64) - toy_index.vectors[None], axis=-1
        )
        assert_array_equal(numbers, np.argsort(apart, axis=1, kind="stable")[:, :10])
        # FAISS squares in float32: values about 50 squared, so errors about 1e-3.
        assert_allclose(distances, np.sort(apart, axis=1)[:, :10], atol=5e-3)

    def test_distances_ascend(self, toy_index: PoseIndex) -> None:
        distances, _ = toy_index.search(toy_index.vectors[:5], 50)
        assert (np.diff(distances, axis=1) >= 0).all()

    def test_finds_itself_at_distance_zero(self, toy_index: PoseIndex) -> None:
        for number in range(0, len(toy_index), 37):
            distances, _ = toy_index.search(toy_index.vectors[number : number + 1], 1)
            assert distances[0, 0] == 0

    def test_gives_no_more_than_all(self, toy_index: PoseIndex) -> None:
        _, numbers = toy_index.search(toy_index.vectors[:1], 10**6)
        assert_array_equal(np.sort(numbers[0]), np.arange(len(toy_index)))


class TestEntries:
    def test_labels(self, toy_index: PoseIndex) -> None:
        entries = [toy_index.entry(number) for number in range(len(toy_index))]
        first = entries[0]
        assert (first.clip, first.action, first.frame) == ("greet", "wave", 2)
        assert {(e.clip, e.action) for e in entries} == {("greet", "wave"), ("stroll", "walk")}
        assert {e.subject for e in entries} == {"slim", "broad"}
        # Each pose is seen by twelve cameras.
        assert [e.frame for e in entries[:36:12]] == [2, 3, 4]
        assert not any(e.mirrored for e in entries)
        assert [e.number for e in entries] == list(range(len(toy_index)))

    def test_points_follow_the_camera(self, toy_index: PoseIndex) -> None:
        entry = toy_index.entry(100)
        body = toy_index.skeletons[toy_index.entries["skeleton"][100]].astype(np.float64)
        rotation = camera_rotation(entry.azimuth_deg, entry.elevation_deg, entry.roll_deg)
        assert_allclose(entry.points_3d, body @ rotation.T, atol=1e-12)
        row = toy_index.entries[100]
        placed = project(entry.points_3d, entry.distance_m) * row["scale"]
        assert_allclose(
            entry.points_normalised,
            placed + np.array([row["offset_x"], row["offset_y"]]),
            atol=1e-4,
        )

    @pytest.mark.parametrize("number", [0, 100, 575])
    def test_mirror_image_is_the_mirrored_body_seen_by_its_camera(
        self, toy_index: PoseIndex, number: int
    ) -> None:
        entry = toy_index.entry(number, mirrored=True)
        body = toy_index.skeletons[toy_index.entries["skeleton"][number]].astype(np.float64)
        rotation = camera_rotation(entry.azimuth_deg, entry.elevation_deg, entry.roll_deg)
        # Azimuths are wrapped to 0..360 in float64: 1e-13 degrees are lost.
        assert_allclose(entry.points_3d, mirror_3d(body) @ rotation.T, atol=1e-9)
        assert 0 <= entry.azimuth_deg < 360

    @pytest.mark.parametrize("number", [0, 100, 575])
    def test_mirror_image_has_the_labels_and_the_mirrored_points(
        self, toy_index: PoseIndex, number: int
    ) -> None:
        entry, image = (toy_index.entry(number, mirrored=m) for m in (False, True))
        assert (entry.mirrored, image.mirrored) == (False, True)
        for field in ("number", "action", "clip", "subject", "frame", "elevation_deg",
                      "distance_m"):  # fmt: skip
            assert getattr(entry, field) == getattr(image, field)
        assert_array_equal(image.points_3d, mirror_3d(entry.points_3d))
        assert_array_equal(image.points_normalised, mirror_normalised(entry.points_normalised))

    @pytest.mark.parametrize("azimuth", [0.0, -0.0, 1e-20, 360.0, 359.99998])
    def test_azimuth_of_a_mirror_image_stays_below_360(
        self, toy_index: PoseIndex, azimuth: float
    ) -> None:
        entries = toy_index.entries.copy()
        entries["azimuth_deg"][7] = azimuth
        index = dataclasses.replace(toy_index, entries=entries)
        for mirrored in (False, True):
            assert 0 <= index.entry(7, mirrored=mirrored).azimuth_deg < 360

    def test_joints_of_mirror_images_lie_on_mirrored_silhouettes(
        self, toy_index: PoseIndex
    ) -> None:
        inside = []
        for number in range(0, len(toy_index), 7):
            image = toy_index.entry(number, mirrored=True)
            x, y = np.rint(image.points_normalised[:19]).astype(int).T
            silhouette = toy_index.silhouette(number)[:, ::-1]
            inside.append(silhouette[y.clip(0, 127), x.clip(0, 47)])
        assert np.mean(inside) > 0.97

    def test_joints_lie_on_their_silhouette(self, toy_index: PoseIndex) -> None:
        numbers = np.arange(0, len(toy_index), 7)
        joints = np.rint(toy_index.points(numbers)[1][:, :19]).astype(int)
        silhouettes = toy_index.silhouettes(numbers)
        inside = silhouettes[
            np.arange(len(numbers))[:, None],
            joints[..., 1].clip(0, 127),
            joints[..., 0].clip(0, 47),
        ]
        assert inside.mean() > 0.97

    def test_silhouettes_fill_their_frame(self, toy_index: PoseIndex) -> None:
        for number in range(0, len(toy_index), 97):
            silhouette = toy_index.silhouette(number)
            again, placement = normalise(silhouette)
            assert placement.scale == pytest.approx(1, abs=0.05)
            assert (again != silhouette).mean() < 0.03

    @pytest.mark.parametrize("number", [-1, 576])
    def test_there_is_no_entry_beyond_the_last(self, toy_index: PoseIndex, number: int) -> None:
        with pytest.raises(IndexError, match=f"expected an entry from 0 to 575, got {number}"):
            toy_index.entry(number)
