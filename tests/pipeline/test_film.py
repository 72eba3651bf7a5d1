"""Films are written without a word, and with the same bytes each time."""

import numpy as np
import pytest

from pipeline.film import write_video

FRAMES = [np.full((48, 64, 3), 40 * i, dtype=np.uint8) for i in range(3)]


def test_a_film_is_written_without_a_word(tmp_path, capfd):
    for name in ("a.webm", "b.webm"):
        write_video(tmp_path / name, FRAMES, 20)
    assert capfd.readouterr() == ("", "")
    assert (tmp_path / "a.webm").read_bytes() == (tmp_path / "b.webm").read_bytes()


def test_a_film_that_cannot_be_written_says_why(tmp_path):
    with pytest.raises(OSError, match=r"OpenCV cannot write a\.webm \(VP8 in WebM\): .+"):
        write_video(tmp_path / "none" / "a.webm", FRAMES, 20)
