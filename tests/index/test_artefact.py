"""The artefact: the same on disk as in memory, or refused in one sentence."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import lzma
import re
from pathlib import Path

import faiss
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from descriptor.descriptor import DiscriminantDescriptor
from index.artefact import FORMAT_VERSION, find_artefact, load_index
from index.build.writer import npy_bytes, save_index
from index.files import ArtefactError
from index.store import PoseIndex
from tests.index.helpers import contents, seal


class TestRoundTrip:
    def test_loads_what_was_saved(self, toy_index: PoseIndex, saved: Path) -> None:
        back = load_index(saved)
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
        save_index(index, tmp_path / "learned")
        back = load_index(tmp_path / "learned")
        assert_array_equal(back.descriptor.describe(silhouettes), index.vectors)
        assert_array_equal(back.descriptor.mirror(index.vectors), learned.mirror(index.vectors))

    def test_same_index_twice_gives_the_same_bytes(
        self, toy_index: PoseIndex, saved: Path, tmp_path: Path
    ) -> None:
        version = save_index(toy_index, tmp_path / "again")
        assert contents(tmp_path / "again") == contents(saved)
        assert load_index(saved).version == version

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
        assert save_index(other, tmp_path / "b") != save_index(toy_index, tmp_path / "a")


class TestRefusal:
    """One sentence that names the file and the fault."""

    def refused(self, folder: Path) -> str:
        with pytest.raises(ArtefactError) as caught:
            load_index(folder)
        message = str(caught.value)
        assert str(folder) in message
        assert "\n" not in message
        return message

    def test_missing_folder(self, tmp_path: Path) -> None:
        assert "there is no index at" in self.refused(tmp_path / "nowhere")

    def test_folder_without_manifest(self, tmp_path: Path) -> None:
        assert "manifest.json is missing" in self.refused(tmp_path)

    def test_every_file_truncated_altered_or_missing(self, saved: Path) -> None:
        for file in sorted(saved.glob("*.*")):
            whole = file.read_bytes()
            altered = whole[:-1] + bytes([whole[-1] ^ 1])
            spoilt = {
                "truncated|unreadable": whole[: len(whole) // 2],
                "altered": altered,
                "": None,
            }
            for said, content in spoilt.items():
                if content is altered and file.name == "manifest.json":
                    continue
                file.unlink()
                if content is not None:
                    file.write_bytes(content)
                message = self.refused(saved)
                assert file.name in message
                assert re.search(said, message)
            file.write_bytes(whole)
        load_index(saved)

    @pytest.mark.parametrize(
        ("content", "said"),
        [
            *((text, "is not the manifest of a pose index")
              for text in (b"[]", b'"pose"', b"{}", b'{"name": "mnist"}')),
            *((text, "is unreadable") for text in (b"", b"{", b"\x80\x02}q\x00.", b"\xff\xfe")),
        ],
    )  # fmt: skip
    def test_another_manifest(self, saved: Path, content: bytes, said: str) -> None:
        (saved / "manifest.json").write_bytes(content)
        assert said in self.refused(saved)

    @pytest.mark.parametrize(
        ("changed", "said"),
        [
            *(({"format_version": number}, f"this service reads format {FORMAT_VERSION}")
              for number in (0, FORMAT_VERSION + 1, "1")),
            ({"joints": ["nose"]}, "another set of joints"),
            ({"descriptor": {"name": "hu"}}, "descriptor"),
            *(({key: None}, key) for key in ("files", "descriptor", "clips", "parameters")),
        ],
    )  # fmt: skip
    def test_a_sealed_manifest_of_something_else(
        self, saved: Path, changed: dict[str, object], said: str
    ) -> None:
        def change(manifest: dict[str, object]) -> None:
            manifest.update(changed)
            for key in [key for key, value in changed.items() if value is None]:
                del manifest[key]

        seal(saved, change)
        assert said in self.refused(saved)

    @pytest.mark.parametrize("name", ["entries.npy", "descriptors.faiss"])
    def test_sealed_files_of_something_else(
        self, toy_index: PoseIndex, saved: Path, name: str
    ) -> None:
        other = faiss.IndexFlatIP(toy_index.descriptor.dimension)
        other.add(toy_index.vectors)
        content, said = {
            "entries.npy": (
                npy_bytes(toy_index.entries[: len(toy_index) // 2]), "does not hold together"
            ),
            "descriptors.faiss": (
                faiss.serialize_index(other).tobytes(),
                "expected a FAISS IndexFlatL2, got IndexFlatIP",
            ),
        }[name]  # fmt: skip
        (saved / f"{name}.xz").write_bytes(lzma.compress(content))
        digest = hashlib.sha256(content).hexdigest()
        seal(saved, lambda manifest: manifest["files"].update({name: digest}))
        assert said in self.refused(saved)

    def test_altered_manifest(self, saved: Path) -> None:
        file = saved / "manifest.json"
        file.write_text(file.read_text().replace('"toy"', '"TOY"'))
        assert "was altered: its content hash does not fit" in self.refused(saved)


class TestFind:
    def test_the_artefact_of_a_version_is_found_alone_or_among_others(
        self, toy_index: PoseIndex, tmp_path: Path
    ) -> None:
        other = dataclasses.replace(toy_index, name="other")
        versions = {
            tmp_path / name: save_index(index, tmp_path / name)
            for name, index in (("first", toy_index), ("second", other))
        }
        for path, version in versions.items():
            assert find_artefact(tmp_path, version) == path
            assert find_artefact(path, version) == path

    def test_what_is_not_there_or_not_whole_is_not_found(self, saved: Path, tmp_path: Path) -> None:
        version = json.loads((saved / "manifest.json").read_text())["version"]
        for folder, wanted in ((tmp_path, "sha256:0"), (tmp_path / "nowhere", version)):
            with pytest.raises(ArtefactError, match=f"of version {wanted} in .*, found none"):
                find_artefact(folder, wanted)
        (saved / "manifest.json").write_text("{")
        with pytest.raises(ArtefactError, match="found none"):
            find_artefact(tmp_path, version)
