"""Memory, threads and priorities of the server's process."""

from __future__ import annotations

import os
import subprocess
import sys
import threading

from app.scheduling.process import lower_thread_priority
from tests.conftest import ROOT

EXPORT = """
import sys, cv2
before = sys.getswitchinterval(), cv2.getNumThreads()
from scripts.export_openapi import render
assert render()
assert (sys.getswitchinterval(), cv2.getNumThreads()) == before
"""


def test_worker_threads_have_a_lower_priority() -> None:
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


def test_importing_the_application_changes_no_process_settings() -> None:
    subprocess.run([sys.executable, "-c", EXPORT], cwd=ROOT, check=True)
