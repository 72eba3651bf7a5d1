"""Films of rollouts as WebM (VP8), which every browser plays and OpenCV's wheels can write."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

FRAMES_PER_SECOND = 20  # twice the environments' 10 actions a second
TRACK_NUMBER = b"\x73\xc5\x88"  # Matroska's TrackUID, an integer of 8 bytes


def write_video(path: Path, frames: Sequence[np.ndarray], frames_per_second: float) -> None:
    """Write RGB pictures (H, W, 3) uint8.

    Raises:
        OSError: the file could not be written.
    """
    height, width, _ = frames[0].shape
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"VP80"), frames_per_second, (width, height))
    if not writer.isOpened():
        raise OSError(f"OpenCV cannot write {path.name} (VP8 in WebM)")
    for frame in frames:
        writer.write(cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))
    writer.release()
    written = path.read_bytes()
    if not written:
        raise OSError(f"OpenCV wrote nothing to {path.name}")
    # The track's number is drawn at random; a fixed one makes the bytes reproducible.
    start = written.index(TRACK_NUMBER) + len(TRACK_NUMBER)
    path.write_bytes(written.replace(written[start : start + 8], (1).to_bytes(8, "big")))
