"""Mistakes a user can make: one clear line, exit code 1, no traceback, everything else as it was."""

import runpy
import sys

import numpy as np
import pytest

from beso.data import play
from beso.envs import spec

DATA = "data/play/block_push"


def started(workspace, name, *arguments):
    """Exit code and output of a stage."""
    done = workspace.run(sys.executable, "-m", "stages", name, *arguments, check=False)
    return done.returncode, done.stdout


@pytest.fixture
def called(monkeypatch, capfd):
    """As `started`, without the seconds that a new process takes to start."""

    def call(workspace, name, *arguments):
        monkeypatch.chdir(workspace.folder)
        monkeypatch.setattr(sys, "argv", ["-m", name, *arguments])
        with pytest.raises(SystemExit) as ended:
            runpy.run_module("stages", run_name="__main__", alter_sys=True)
        return ended.value.code, "".join(capfd.readouterr())

    return call


def fails(run, workspace, name, *arguments):
    """Run a stage that must fail; its one line of error, after checking that results are as before."""
    before = workspace.files("models", "results", "reports")
    code, output = run(workspace, name, *arguments)
    assert code == 1, output
    assert "Traceback" not in output
    assert workspace.files("models", "results", "reports") == before
    lines = [line for line in output.splitlines() if line.startswith("error: ")]
    assert len(lines) == 1, output
    return lines[0]


def test_unknown_parameter(small):
    small.set("methods.gcbc.train.block_push.model.depth", 3)
    line = fails(started, small, "resolve")
    assert "params.yaml.methods.gcbc.train.block_push.model.depth = 3: unknown key" in line
    small.set("methods.gcbc.train.block_push.model", {"width": 32, "layers": 2, "dropout": 0.1})
    small.beso("check")


def test_wrong_type_through_dvc(small):
    parameters = small.folder / "params.yaml"
    good = parameters.read_bytes()
    small.set("methods.gcbc.train.block_push.optimization.steps", "many")
    before = small.files("data", "results", "reports")
    done = small.dvc("repro", check=False)
    assert done.returncode != 0
    assert "optimization.steps = 'many': expected an integer" in done.stdout
    assert "Traceback" not in done.stdout
    assert small.files("data", "results", "reports") == before
    parameters.write_bytes(good)
    assert small.repro() == []  # what the failed stage's start removed comes back from DVC's cache


def test_a_teacher_of_other_data(small, called):
    cell, models = ("train", "block_push", "c_beso_one_step"), "models/block_push/c_beso"
    description = small.folder / models / "seed1.json"
    description.write_text(description.read_text().replace('"data": "', '"data": "x'))
    assert (
        fails(called, small, *cell) == f"error: {models}, the teacher, was trained on other play data; train it again"
    )
    description.unlink()
    assert fails(called, small, *cell) == f"error: {models}/seed1.json is missing: train this model first"


def test_nan_in_a_dataset(small, called):
    folder = small.folder / DATA
    dataset = play.load(folder, spec("block_push"))
    observations = np.array(dataset.observations)
    observations[7, 3] = np.nan
    broken = play.PlayDataset(
        observations, np.array(dataset.actions), np.array(dataset.tasks), np.array(dataset.episode_ends), {}
    )
    play.save(broken, folder)
    line = fails(called, small, "train", "block_push", "gcbc")
    assert "observations has a value that is not finite (NaN or infinity), first at step 7" in line


def test_truncated_array(small, called):
    path = small.folder / DATA / "actions.npy"
    path.write_bytes(path.read_bytes()[:-100])
    assert "actions.npy is truncated" in fails(called, small, "train", "block_push", "gcbc")


def test_missing_dataset(small, called):
    (small.folder / DATA).rename(small.folder / "elsewhere")
    assert "data/play/block_push is not a play dataset" in fails(called, small, "train", "block_push", "gcbc")


def test_missing_and_altered_trials(small, called):
    folder = small.folder / "data/trials/block_push"
    goals = folder / "goal.npy"
    goals.write_bytes(goals.read_bytes()[:-4] + b"\0\0\0\1")
    assert "goal.npy is not the file that trials.json describes" in fails(
        called, small, "evaluate", "block_push", "gcbc"
    )
    folder.rename(small.folder / "elsewhere")
    line = fails(called, small, "evaluate", "block_push", "gcbc")
    assert "data/trials/block_push has no trials.json: run `dvc repro trials`" in line


def test_damaged_checkpoint(small):
    small.machine(workers=2)
    path = small.folder / "models/block_push/gcbc/seed1.safetensors"
    path.write_bytes(path.read_bytes()[:100])
    assert "seed1.safetensors is missing or damaged" in fails(started, small, "evaluate", "block_push", "gcbc")


@pytest.mark.parametrize(
    ("env", "message"),
    [
        ("block_push", "nowhere holds no demonstrations: `folder` must hold multimodal_push_observations"),
        ("kitchen", "nowhere holds no demonstrations: `folder` must hold observations_seq"),
    ],
)
def test_published_folder_that_is_not_there(workspace, env, message, called):
    workspace.set(f"environments.{env}.collect.source", "published")
    workspace.set(f"environments.{env}.collect.folder", "nowhere")
    workspace.python("-m", "stages", "resolve")
    assert message in fails(called, workspace, "collect", env)


def test_missing_results(small):
    (small.folder / "results/block_push/gcbc.csv").unlink()
    line = fails(started, small, "tables")
    assert line == ("error: results/block_push/gcbc.csv is missing: run `dvc repro evaluate@block_push-gcbc`")


def test_wrong_number_of_arguments(finished, called):
    wrong = ((started, ()), (called, ("block_push",)), (called, ("block_push", "gcbc", "more")))
    for run, arguments in wrong:
        code, output = run(finished, "train", *arguments)
        assert code == 2
        assert output.splitlines()[-1] == "usage: python -m stages train ENV METHOD"


def test_unknown_names(finished, called):
    missing = "recipes/{}.json is missing: params.yaml has no such entry, or `dvc repro resolve` has not run"
    for name in ("train", "evaluate"):
        assert missing.format(f"{name}/moon/gcbc") in fails(called, finished, name, "moon", "gcbc")
        assert missing.format(f"{name}/block_push/sac") in fails(called, finished, name, "block_push", "sac")
    assert missing.format("collect/moon") in fails(called, finished, "collect", "moon")
    assert missing.format("study/moons") in fails(called, finished, "study", "moons")
    code, output = called(finished, "dance")
    assert code == 2
    assert output.startswith("usage: python -m stages STAGE [NAME ...], where STAGE is one of collect, evaluate, ")
