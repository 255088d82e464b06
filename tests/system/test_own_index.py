"""An index of one's own, as docs/index.md describes it: three clips of another rig, served."""

import json
import re
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from fastapi.testclient import TestClient

from app.main import create_app
from app.photograph import load_estimator
from app.settings import Settings
from index.artefact import load_index
from tests.conftest import SHARED
from tests.support.programs import run

MOCAP = SHARED / "mocap"

CLIPS = {"jump_train_1": "jump", "basketball_train_1": "basketball", "14_30": "kneel"}

RENAMED = {"LeftArm": "arm.L", "RightArm": "arm.R", "Head": "skull"}

COMMANDS = (
    ("build", "--entries", "480", "--views", "4", "--attribution", "Motion by us."),
    ("train-reranker", "--passes", "1"),
)


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("anny", reason="needs the build extra")
    if not MOCAP.exists():
        pytest.skip(f"needs the motion data in {MOCAP}")
    folder = tmp_path_factory.mktemp("own")
    mocap, out = folder / "mocap", folder / "our-index"
    (mocap / "bvh").mkdir(parents=True)
    lines = ["clip,subject,action,start_frame,end_frame,fps,description"]
    for clip, action in CLIPS.items():
        text = (MOCAP / "bvh" / f"{clip}.bvh").read_text()
        for ours, theirs in RENAMED.items():
            text = re.sub(rf"JOINT {ours}\s*\n", f"JOINT {theirs}\n", text)
        (mocap / "bvh" / f"{clip}.bvh").write_text(text)
        lines.append(f"{clip},s,{action},0,100,30,")
    (mocap / "manifest.csv").write_text("\n".join(lines) + "\n")
    (mocap / "rig.json").write_text(json.dumps({"joints": RENAMED}))
    for name, *options in COMMANDS:
        place = "--out" if name == "build" else "--index"
        command = [sys.executable, "-m", "scripts", name, "--mocap", mocap, place, out, *options]
        done = run(*command, timeout_s=900)
        assert done.returncode == 0, done.stderr
        assert "ends of" in done.stdout
    return out


@pytest.mark.slow
def test_it_names_its_source_and_its_calibration(built: Path) -> None:
    index = load_index(built)
    assert index.name == "our-index"
    assert index.parameters["attribution"].startswith("Motion by us. Bodies by MakeHuman")
    assert "cmu" not in index.parameters["attribution"].lower()
    assert "ends of clips" in index.parameters["confidence_fitted_on"]
    assert index.reranker is not None
    assert index.reranker.training["index"] == index.version
    assert index.reranker.training["of_clips_held_out"] is False


@pytest.mark.slow
def test_it_is_served(built: Path) -> None:
    silhouette = cv2.copyMakeBorder(load_index(built).silhouette(7), 9, 9, 9, 9, 0)
    mask = cv2.imencode(".png", np.asarray(255 * silhouette, np.uint8))[1].tobytes()
    settings = Settings(index=built)
    with TestClient(create_app(settings, load_estimator(settings))) as client:
        described = client.get("/index").json()
        reply = client.post("/pose", files={"mask": ("mask.png", mask, "image/png")})
    assert described["name"] == "our-index"
    assert "confidence_fitted_on" in described["parameters"]
    assert reply.status_code == 200
    (person,) = reply.json()["persons"]
    assert person["hypotheses"][0]["source"]["action"] in load_index(built).actions
