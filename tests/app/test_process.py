"""Memory, threads and priorities of the server's process."""

from __future__ import annotations

import os
import subprocess
import sys
import threading

from app.work.process import lower_thread_priority
from tests.conftest import ROOT

EXPORT = """
import sys, cv2
before = sys.getswitchinterval(), cv2.getNumThreads()
from app.main import create_app
from app.settings import Settings
assert create_app(Settings()).openapi()
assert (sys.getswitchinterval(), cv2.getNumThreads()) == before
"""


def test_threads_that_work_have_a_lower_priority_than_the_one_that_answers() -> None:
    priorities: list[int] = []

    def work() -> None:
        for _ in range(2):  # Lowering it twice is the same as once.
            lower_thread_priority()
            priorities.append(os.getpriority(os.PRIO_PROCESS, threading.get_native_id()))

    worker = threading.Thread(target=work)
    worker.start()
    worker.join()
    own = os.getpriority(os.PRIO_PROCESS, os.getpid())
    assert priorities == [min(19, own + 5)] * 2


def test_an_application_that_does_not_serve_changes_nothing_of_its_process() -> None:
    subprocess.run([sys.executable, "-c", EXPORT], cwd=ROOT, check=True)
