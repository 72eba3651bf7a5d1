"""Films as WebM (VP8), which every browser plays and OpenCV's wheels can write."""

import contextlib
import io
import os
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from beso.errors import CannotDrawError
from beso.files import replacing, write_json
from pipeline.pool import HERE, map_jobs

FRAMES_PER_SECOND = 20  # about twice the environments' actions a second
TRACK_NUMBER = b"\x73\xc5\x88"  # Matroska's TrackUID, an integer of 8 bytes


def write_film(target: Path, film: Callable[..., dict[str, Any]], job: tuple[Any, ...], against: str = "") -> None:
    """Write a folder with `rollout.webm`, which `film(*job, path)` writes, and `rollout.json`, the row that it returns.

    With a reason against it, or on a machine that cannot draw, there is no film, and the row is the reason (`no_film`).
    """
    with replacing(target) as folder:
        folder.mkdir()
        try:
            (row,) = [{"no_film": against}] if against else map_jobs(film, [(*job, folder / "rollout.webm")], HERE)
        except CannotDrawError as error:
            print(f"no film: {error}")
            row = {"no_film": str(error)}
        write_json(folder / "rollout.json", row)


def write_video(path: Path, frames: Sequence[np.ndarray], frames_per_second: float) -> None:
    """Write RGB pictures (H, W, 3) uint8.

    Raises:
        OSError: the file could not be written.
    """
    height, width, _ = frames[0].shape
    with _stderr() as told:
        writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"VP80"), frames_per_second, (width, height))
    if not writer.isOpened():
        raise OSError(f"OpenCV cannot write {path.name} (VP8 in WebM): {told.getvalue().strip()}")
    for frame in frames:
        writer.write(cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))
    writer.release()
    written = path.read_bytes()
    if not written:
        raise OSError(f"OpenCV wrote nothing to {path.name}")
    # The track's number is drawn at random; a fixed one makes the bytes reproducible.
    start = written.index(TRACK_NUMBER) + len(TRACK_NUMBER)
    path.write_bytes(written.replace(written[start : start + 8], (1).to_bytes(8, "big")))


@contextlib.contextmanager
def _stderr() -> Iterator[io.StringIO]:
    """Keep what this process writes to its standard error, from whatever language.

    OpenCV complains about VP8's code in every WebM file, whichever is given, and then writes it.
    """
    kept, text = os.dup(2), io.StringIO()
    with tempfile.TemporaryFile() as file:
        sys.stderr.flush()
        os.dup2(file.fileno(), 2)
        try:
            yield text
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            file.seek(0)
            text.write(file.read().decode(errors="replace"))
