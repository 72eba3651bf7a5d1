"""Training where little is installed, and bringing the models back."""

import math
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from beso import envs
from beso.data import play
from beso.errors import UserError
from beso.files import read_json, write_json
from pipeline import params, paths, profile
from pipeline.machine import Machine
from pipeline.tools import bench_training, publish
from pipeline.tools.import_cells import import_cells
from pipeline.tools.train import train_cells
from stages import train as stage

ROOT = Path(__file__).parents[3]
CELL = "block_push-c_beso"
ABSENT = ["dvc", "pybullet", "mujoco", "gymnasium", "cv2", "pandas", "scipy", "sklearn", "matplotlib", "jinja2", "ray"]


def random_play(spec):
    draws = np.random.default_rng(0)

    def episode(steps):
        observations = draws.standard_normal((steps, spec.observation_size)).cumsum(axis=0)
        actions = draws.uniform(-1, 1, (steps, spec.action_size))
        return play.Episode(observations, actions, np.zeros((steps, len(spec.tasks))))

    return play.assemble([episode(20) for _ in range(6)], spec, {"source": "random paths"})


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder with params.yaml, two short seeds a cell, and play data; the current one."""
    monkeypatch.chdir(ROOT)
    text = profile.render("smoke")
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("BESO_SCRATCH", raising=False)
    Path("params.yaml").write_text(text, encoding="utf-8")
    spec = envs.spec("block_push")
    play.save(random_play(spec), paths.play("block_push"))
    return tmp_path


def models(folder):
    return {path.name: path.read_bytes() for path in Path(folder).rglob("seed*") if path.is_file()}


def train_stage():
    stage.train_cell(params.load().cells[CELL].train, Machine.load())


def run(*cells, seeds=(), hours=math.inf):
    train_cells(cells or (CELL,), seeds, hours, Path("trained"))


def test_it_runs_where_little_is_installed(place):
    code = f"""
import sys
for name in {ABSENT}:
    sys.modules[name] = None
from pipeline.cli import cli
cli(["train", "{CELL}"])
"""
    (place / "dvc.yaml").touch()
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=place, env=environment, capture_output=True, text=True, check=False
    )
    assert done.stdout == f"all trained: {CELL}\n", done.stderr
    assert models("trained")


def test_a_package_that_one_method_needs_is_named(place, monkeypatch):
    monkeypatch.setitem(sys.modules, "sklearn.cluster", None)
    with pytest.raises(UserError, match=r"block_push-c_bet needs the package sklearn.*: install it, or leave"):
        run("block_push-c_bet")


def test_what_time_cuts_off_continues_to_the_stages_bytes(place, capsys):
    run(hours=0)
    assert "time is over in block_push-c_beso" in capsys.readouterr().out
    (state,) = Path("trained").rglob("state.safetensors")
    assert (state.parent / "curve.csv").read_text().startswith("step,training_loss,")
    run()
    assert not list(Path("trained").rglob("state.safetensors"))
    train_stage()
    assert models("trained") == models("models")
    (curve, *_) = Path("trained").rglob("curve.csv")
    last = curve.read_text().splitlines()[-1]
    assert last.startswith(f"{params.load().cells[CELL].train.first.config.optimization.steps},")


def test_unknown_cells_and_seeds_are_refused(place):
    with pytest.raises(UserError, match=r"profile smoke has no cell x: block_push-gcbc"):
        run("x")
    with pytest.raises(UserError, match=r"block_push-c_beso has no seed 99 in params.yaml"):
        run(seeds=(99,))


def test_the_stage_takes_what_was_brought_back(place, monkeypatch, capsys):
    run()
    import_cells(Path("trained"))
    assert capsys.readouterr().out.endswith(f"{CELL}: all seeds\n")
    monkeypatch.setattr(stage, "Training", None)  # nothing is trained
    train_stage()
    assert models("models") == models("trained")
    import_cells(Path("trained"))
    assert capsys.readouterr().out.endswith(f"{CELL}: all seeds; run `dvc repro --force --single-item train@{CELL}`\n")
    assert params.load().cells[CELL].curve.read_text().startswith("step,learning_rate,training_loss,")


def test_models_of_an_archive_are_taken_as_trained(place, monkeypatch, capsys):
    train_stage()
    for weights in params.load().cells[CELL].models.glob("*.safetensors"):
        publish.halve(weights, weights)
    kept = models("models")
    shutil.move("models", "archive/models")
    Path("archive/models/block_push/gcbc").mkdir()
    shutil.copy("archive/models/block_push/c_beso/seed1.json", "archive/models/block_push/gcbc")  # no weights
    write_json(Path("archive/data/play/calvin/encoder.json"), {})  # of an encoder that was too large
    import_cells(Path("archive"))
    said = capsys.readouterr().out
    assert "archive/models/block_push/c_beso: taken; it does not tell which state of beso/ trained it\n" in said
    assert f"{CELL}: all seeds\n" in said
    assert "gcbc" not in said
    monkeypatch.setattr(stage, "Training", None)  # nothing is trained
    train_stage()
    assert models("models") == kept
    with pytest.raises(UserError, match=r"data has no model of a cell of params\.yaml"):
        import_cells(Path("data"))
    shutil.rmtree("data")
    import_cells(Path("archive"))
    assert f"{CELL}: data/play/block_push is not a play dataset" in capsys.readouterr().out


def test_students_learn_from_the_teacher_beside_them(place, capsys):
    student = "block_push-c_beso_one_step"
    with pytest.raises(UserError, match=r"models/block_push/c_beso/seed1.json is missing: train this model first"):
        run(student, seeds=(1,))
    run(CELL, student)
    teacher = models("models")
    assert teacher == models("trained/block_push/c_beso")
    for path in Path("models").rglob("seed2*"):
        path.unlink()
    run(student)
    assert models("models") == teacher, "a missing seed is brought too"
    description = Path("models/block_push/c_beso/seed1.json")
    write_json(description, read_json(description) | {"job": {}})
    with pytest.raises(UserError, match=r"seed1\.json is a checkpoint of another configuration: "):
        run(student)
    shutil.rmtree("models")
    import_cells(Path("trained"))
    assert f"{student}: models/block_push/c_beso/seed1.json is missing: train" in capsys.readouterr().out
    train_stage()
    import_cells(Path("trained"))
    assert f"{student}: all seeds" in capsys.readouterr().out


def test_the_speed_of_training_is_a_table(place, capsys):
    bench_training.bench([CELL], [1, 2], ["fp32"], 0.05)
    rows = capsys.readouterr().out.splitlines()[3:]
    assert [row.split(" | ")[4] for row in rows] == ["1", "2"]
    assert all(float(row.split(" | ")[5].split()[0]) > 0 for row in rows)
    with pytest.raises(UserError, match=r"has no cell x: block_push-gcbc"):
        bench_training.bench(["x"], [1], ["fp32"], 0.05)


def test_other_parameters_data_and_code_are_told(place, monkeypatch, capsys):
    run()
    text = Path("params.yaml").read_text(encoding="utf-8")
    Path("params.yaml").write_text(text.replace("train_fraction: 0.", "train_fraction: 0.1"), encoding="utf-8")
    import_cells(Path("trained"))
    assert "of other parameters\nblock_push-c_beso: dvc repro would train seeds 1, 2 here" in capsys.readouterr().out

    Path("params.yaml").write_text(text, encoding="utf-8")
    (folder,) = Path("trained/block_push/c_beso").glob("seed1-*")
    folder.rename(folder.with_name("seed1-0123456789abcdef"))
    import_cells(Path("trained"))
    assert "taken, but beso/ has changed since" in capsys.readouterr().out

    changed = random_play(envs.spec("block_push"))
    changed.actions[0] = 0
    play.save(changed, paths.play("block_push"))
    import_cells(Path("trained"))
    assert "of other play data\n" in capsys.readouterr().out
