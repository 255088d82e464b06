"""Zones of a camera over HTTP, and the file that configures cameras."""

import json
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient

from app.api.tracking_schemas import CameraEvents, CameraState
from app.serving import read_cameras
from app.settings import SettingsError
from tests.conftest import Photo, Serving
from tests.support.service import check_problem, eventually, send

LEFT = {"name": "door", "kind": "watch", "polygon": [[0, 0], [100, 0], [100, 240], [0, 240]]}
RIGHT = {"name": "bed", "kind": "rest", "polygon": [[100, 0], [400, 0], [400, 500], [100, 500]]}


def configure(client: TestClient, *zones: Any, camera: str = "yard", **options: Any) -> Any:
    return client.put(f"/cameras/{camera}", json={"zones": zones}, **options)


def track(client: TestClient, photo: Photo, boxes: Any, **fields: str) -> dict[str, Any]:
    response = client.post(
        "/cameras/yard/frames",
        files={"frame": photo.frame_png},
        data={"boxes": json.dumps(boxes), **fields},
        params={"evidence": "silhouette", "n": 1},
    )
    assert response.status_code == 200, response.text
    answer: dict[str, Any] = response.json()
    return answer


class TestConfigure:
    def test_zones_are_shown_before_during_and_after_a_session(
        self, serving: Serving, photo: Photo
    ) -> None:
        with serving(camera_idle_s=2.0) as client:
            for response in (configure(client, LEFT, RIGHT), client.get("/cameras/yard")):
                state = CameraState.model_validate_json(response.content)
                assert [zone.model_dump() for zone in state.zones] == [LEFT, RIGHT]
                assert (state.frames, state.timestamp, state.image, state.idle_s) == (
                    0, None, None, None,
                )  # fmt: skip
            send(client, photo)
            assert client.get("/cameras/yard").json()["frames"] == 1
            eventually(lambda: client.get("/cameras/yard").json()["frames"] == 0)
            assert client.get("/cameras/yard").json()["zones"] == [LEFT, RIGHT]
            (listed,) = client.get("/cameras").json()["cameras"]
            assert listed["camera_id"] == "yard"

    def test_cameras_that_never_sent_a_frame_make_room(
        self, serving: Serving, photo: Photo
    ) -> None:
        def configured() -> list[str]:
            return [camera["camera_id"] for camera in client.get("/cameras").json()["cameras"]]

        with serving(max_cameras=2) as client:
            for camera in ("yard", "gate", "yard", "roof"):
                assert configure(client, LEFT, camera=camera).status_code == 200
            assert configured() == ["roof", "yard"]
            send(client, photo, "yard")
            assert configure(client, LEFT, camera="gate").status_code == 200
            assert configured() == ["gate", "yard"]
            send(client, photo, "gate")
            refused = configure(client, LEFT, camera="roof")
            assert "at most 2 cameras" in check_problem(refused, 409)
            assert refused.json()["reason"] == "too_many_cameras"
            assert configure(client, RIGHT, camera="gate").status_code == 200
            assert configure(client, camera="gate").status_code == 200
            assert configure(client, LEFT, camera="roof").status_code == 200


class TestFile:
    @pytest.fixture
    def file(self, tmp_path: Path) -> Path:
        path = tmp_path / "cameras.json"
        path.write_text(json.dumps({"yard": {"zones": [LEFT], "fov_deg": 72}, "gate": {}}))
        return path

    def test_cameras_of_the_file_are_configured_until_callers_do_it(
        self, serving: Serving, file: Path, photo: Photo
    ) -> None:
        with serving(cameras_file=file) as client:
            listed = client.get("/cameras").json()["cameras"]
            assert [camera["camera_id"] for camera in listed] == ["gate", "yard"]
            state = send(client, photo).json()["image"]
            assert (state["fov_deg"], state["fov_given"]) == (72, True)
            assert configure(client).json()["zones"] == []
            assert client.get("/cameras/yard").json()["fov_deg"] is None
            assert client.delete("/cameras/yard").status_code == 204
            assert client.get("/cameras/yard").json()["zones"] == [LEFT]

    @pytest.mark.parametrize(
        ("text", "problem"),
        [
            ("{", "expected valid JSON"),
            ("[]", "expected a JSON object, got []"),
            ('{"../yard": {}}', "../yard: expected text of the form"),
            ('{"yard": {"zone": []}}', "yard: expected one of the fields zones, fov_deg,"),
            (
                '{"yard": {"zones": [{"name": "bed"}]}}',
                "yard.zones[0].kind: expected 'rest' or 'watch'",
            ),
        ],
    )
    def test_a_wrong_file_is_refused_in_a_sentence(
        self, tmp_path: Path, text: str, problem: str
    ) -> None:
        path = tmp_path / "cameras.json"
        path.write_text(text)
        with pytest.raises(SettingsError) as error:
            read_cameras(path)
        assert str(error.value).startswith(f"POSE_CAMERAS_FILE: {path}: ")
        assert problem in str(error.value)


class TestEvents:
    def test_the_last_hundred_are_kept_until_the_camera_is_forgotten(
        self, client: TestClient, photo: Photo
    ) -> None:
        seen = []
        for number in range(51):  # After each gap, the person leaves and enters anew.
            answer = client.post(
                f"/cameras/yard/frames?n=1&evidence=silhouette&timestamp={20 * number}",
                files={"mask": photo.mask_png},
            )
            seen += answer.json()["events"]
        reply = CameraEvents.model_validate_json(client.get("/cameras/yard/events").content)
        assert [event.model_dump() for event in reply.events] == seen[-100:]
        client.delete("/cameras/yard")
        check_problem(client.get("/cameras/yard/events"), 404)

    def test_a_person_in_a_zone_enters_it_and_leaves_it(
        self, client: TestClient, photo: Photo
    ) -> None:
        assert client.put("/cameras/yard", json={"fov_deg": 60}).status_code == 200
        configure(client, RIGHT)
        box, crossings = [145, 35, 58, 140], []
        frames = [(number / 2, "a") for number in range(5)] + [(5.0, "b")]
        for seconds, name in frames:
            answer = track(client, photo, [box], track_ids=f'["{name}"]', timestamp=str(seconds))
            crossings += [
                (e["event"], e["caller_track_id"], e["zones"], e["dwell_s"])
                for e in answer["events"]
            ]
        assert crossings == [
            ("entered", "a", ["bed"], None),
            ("zone_entered", "a", ["bed"], None),
            ("entered", "b", ["bed"], None),
            ("zone_left", "a", ["bed"], 2.0),
            ("left", "a", ["bed"], None),
        ]
