"""MediaPipe Pose as a process of its own: its packages and the service's exclude each other.

A line with the size of a JPEG file comes before the file itself. The answer is a line with the
number of people read: MediaPipe reads one.
"""

import sys

import cv2
import mediapipe
import numpy as np


def main() -> None:
    """Read people as in a video, each frame from where the last one left them, with the mask."""
    pose = mediapipe.solutions.pose.Pose(model_complexity=1, enable_segmentation=True)
    while size := sys.stdin.buffer.readline():
        data = np.frombuffer(sys.stdin.buffer.read(int(size)), np.uint8)
        frame = np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR))
        found = pose.process(cv2.cvtColor(frame, cv2.COLOR_BGR2RGB))
        print(int(found.pose_landmarks is not None), flush=True)


if __name__ == "__main__":
    main()
