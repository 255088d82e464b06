"""The networks that find and read people, sharing the cores."""

from __future__ import annotations

from app.settings import Settings
from app.vision.detection.detector import Detector, HogDetector, NetworkDetector
from app.vision.detection.pose_detection import PoseDetection
from app.vision.keypoints.movenet import MoveNet
from app.vision.keypoints.reader import KeypointReader
from app.vision.person.landmarks import LandmarkNetwork
from app.vision.person.reader import PersonReader
from app.vision.weights import network_path
from app.work.cores import available_cores

# Two threads share a pass of a network with little loss; more do not.
_NETWORK_THREADS = 2


def network_threads(cores: int, concurrency: int) -> tuple[int, int]:
    """Threads of one pass of a network, and copies of it, that share the cores.

    Examples
    --------
    >>> network_threads(cores=8, concurrency=8)
    (2, 4)
    """
    threads = min(_NETWORK_THREADS, cores)
    return threads, max(1, min(concurrency, cores // threads))


def load_networks(settings: Settings) -> tuple[Detector, PersonReader]:
    """Load what finds people and what reads them.

    Raises
    ------
    NetworkError
        If a network of the package is missing or altered.
    """
    threads, copies = network_threads(available_cores(), settings.concurrency)
    share = {"threads": threads, "copies": copies}
    movenet = MoveNet(network_path("movenet"), **share)
    landmarks = LandmarkNetwork(network_path("pose_landmarks"), **share)
    reader = PersonReader(landmarks, KeypointReader(movenet))
    smallest = settings.min_person_px
    if settings.detector == "hog":
        return HogDetector(min_person_px=smallest), reader
    pose_detection = PoseDetection(network_path("pose_detection"), **share)
    return NetworkDetector(movenet, pose_detection, landmarks, min_person_px=smallest), reader
