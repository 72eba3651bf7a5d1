"""`beso demo` with what an archive keeps of block push."""

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from beso.errors import UserError
from pipeline.film import write_video
from pipeline.tools import demo

ROOT = Path(__file__).parents[3]
KEPT = ("params.yaml", "data/trials/block_push", "models/block_push/c_beso")


@pytest.fixture
def run(tmp_path, monkeypatch):
    """An archive that keeps the weights of block push alone."""
    monkeypatch.chdir(ROOT)
    for name in KEPT:
        source, target = ROOT / "reports/published/cpu" / name, tmp_path / "run" / name
        target.parent.mkdir(parents=True, exist_ok=True)
        (shutil.copytree if source.is_dir() else shutil.copyfile)(source, target)
    return tmp_path / "run"


def test_an_archived_policy_plays_and_is_filmed(run, tmp_path, capfd):
    demo.demo([], run, 1, tmp_path / "films", tmp_path / "picture.webp")
    told, trouble = capfd.readouterr()
    outcomes = [  # which it is differs from processor to processor
        f"C-BESO in Block-Push: {n} of 1 goals reached\n  episode 0: block 2 to target 2, block 1 to target 1: {done}, "
        for n, done in enumerate(("not reached", "reached"))
    ]
    assert any(outcome in told for outcome in outcomes), told
    assert f"beso watch block_push-c_beso --run {run} --episode 3\n" in told
    assert "OpenCV" not in trouble
    assert [path.name for path in (tmp_path / "films").iterdir()] == ["block_push-c_beso.webm"]
    assert len(demo.read(tmp_path / "films/block_push-c_beso.webm")) > 20
    assert (tmp_path / "picture.webp").read_bytes()[8:12] == b"WEBP"


def test_films_stand_beside_each_other_to_the_end_of_the_longest(tmp_path):
    films = [tmp_path / "short.webm", tmp_path / "long.webm"]
    for film, count, darker in zip(films, (8, 40), (20, 5), strict=True):
        write_video(film, [np.full((240, 320, 3), 240 - darker * i, np.uint8) for i in range(count)], 20)
    demo.side_by_side(films, tmp_path / "both.webp")
    _, animation = cv2.imreadanimation(str(tmp_path / "both.webp"))
    frames = np.array(animation.frames)[..., :3]
    assert frames.shape == (11, demo.HEIGHT, 2 * 240, 3)  # one in four of 39 frames, and the last
    assert frames[:, 90, 60].mean(axis=1) == pytest.approx([240, 160, 100] + [100] * 8, abs=6)
    assert frames[:, 90, 420].mean(axis=1) == pytest.approx([*range(240, 40, -20), 45], abs=6)


def test_an_episode_reaches_its_goal_with_all_of_its_tasks_in_any_order():
    assert demo.reached({"goal_tasks": "3 0", "tasks": "0 2 3"})
    assert not demo.reached({"goal_tasks": "3 0", "tasks": "3"})


def test_mistakes_are_one_line(run, tmp_path):
    with pytest.raises(UserError, match=r"must be a \.webp file in a folder that exists"):
        demo.demo([], run, 1, tmp_path / "films", tmp_path / "picture.gif")
    with pytest.raises(UserError, match=r"keeps no weights of block_push-gcbc, but of block_push-c_beso$"):
        demo.demo(["block_push-gcbc"], run, 1, tmp_path / "films", None)
    with pytest.raises(UserError, match=r"--episodes 1000000000: .*run has \d+ of block_push-c_beso$"):
        demo.demo([], run, 10**9, tmp_path / "films", None)
    (run / "models/block_push/c_beso/seed1.safetensors").unlink()
    with pytest.raises(UserError, match="keeps no weights: "):
        demo.demo([], run, 1, tmp_path / "films", None)
    with pytest.raises(UserError, match="there is no film"):
        demo.side_by_side([], tmp_path / "picture.webp")
