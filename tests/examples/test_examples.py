"""The scripts in examples/, as a reader runs them, but for less long."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
HEAVY = (
    "pipeline",
    "stages",
    "dvc",
    "pandas",
    "gymnasium",
    "mujoco",
    "pybullet",
    "cv2",
    "sklearn",
    "scipy",
    "matplotlib",
)


def run(folder, name, *arguments):
    """What an example prints. Packages beyond the library's own are not there for one that trains."""
    hidden = HEAVY if name == "train_on_own_data" else ()
    hide = f"import runpy, sys; sys.modules.update(dict.fromkeys({hidden}))"
    code = f"{hide}; sys.argv.pop(0); runpy.run_path(sys.argv[0], run_name='__main__')"
    command = [sys.executable, "-c", code, str(ROOT / "examples" / f"{name}.py"), *arguments]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, cwd=folder, env=environment, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_examples_are_short(path):
    assert len(path.read_text().splitlines()) < 60


def test_play_of_ones_own_trains_without_the_pipelines_packages(tmp_path):
    (line,) = run(tmp_path, "train_on_own_data", "--steps", "3")
    assert line.startswith("from [")
    draws = np.random.default_rng(0)
    own = {
        "observations": draws.random((60, 5)),
        "actions": draws.random((60, 3)),
        "episode_ends": np.arange(20, 61, 20),
    }
    np.savez(tmp_path / "play.npz", **own)
    (line,) = run(tmp_path, "train_on_own_data", "play.npz", "--steps", "3")
    assert len(line.partition("demonstrated [")[2].split()) == 3
    assert (tmp_path / "own/model/seed1.safetensors").is_file()


def test_a_policy_of_ones_own_plays_the_archives_episodes():
    *_, own, archived = run(ROOT, "evaluate_own_policy", "--episodes", "1")
    assert own.startswith("own 0 {'tasks': '', 'reward': 0.0, 'result': 0.0, 'length': 299,")
    assert archived.startswith("C-BESO 0 {'tasks': '0 3', 'reward': 1.0, 'result': 1.0,")


def test_samplers_are_compared_on_an_archived_policy():
    lines = run(ROOT, "compare_samplers", "--episodes", "1")[-3:]
    assert [line.partition(": result ")[0] for line in lines] == ["DDIM, 3 steps", "Heun, 3 steps", "Euler, 10 steps"]
