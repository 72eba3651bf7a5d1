"""The command `beso` as its user meets it."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import click
import pandas as pd
import pytest

from beso.files import write_text
from pipeline import cli, scratch
from pipeline.guard import guard

ROOT = Path(__file__).parents[2]
HEAVY = ("torch", "numpy", "pandas", "dvc", "ruamel", "tqdm")


def beso(folder, *arguments, code=0):
    """Both outputs of the command, called in a folder."""
    command = [sys.executable, "-m", "pipeline.cli", *arguments]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    done = subprocess.run(command, cwd=folder, env=environment, check=False, **streams)
    assert done.returncode == code, done.stdout
    return done.stdout


def commands(group=cli.cli, words=()):
    for name, command in group.commands.items():
        yield (*words, name)
        if hasattr(command, "commands"):
            yield from commands(command, (*words, name))


@pytest.mark.parametrize("words", [(), *commands()], ids=" ".join)
def test_help_is_complete(words, capsys):
    cli.cli([*words, "--help"], prog_name="beso", standalone_mode=False)
    text = capsys.readouterr().out
    assert text.startswith(f"Usage: {' '.join(('beso', *words))} ")
    described = text.split("\n\n")[1]
    assert described.strip()[-1] in ".:"
    assert described.strip()[:1].isupper()
    assert not [line for line in text.splitlines() if line.startswith("  ") and line.endswith("...")], (
        "a first line too long for the list"
    )


def test_help_imports_nothing_heavy():
    code = f"import sys, pipeline.cli; print([name for name in {HEAVY} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, capture_output=True, text=True)
    assert done.stdout == "[]\n"


def test_mistakes_are_told_in_one_line(tmp_path):
    line = beso(tmp_path, "check", code=1)
    assert line == f"error: neither {tmp_path} nor a folder above it has dvc.yaml: go to the repository (`cd`)\n"
    assert "No such command 'fly'" in beso(tmp_path, "fly", code=2)
    (tmp_path / "dvc.yaml").touch()
    assert beso(tmp_path, "check", code=1) == "error: params.yaml is missing: run this in the repository's root\n"


@pytest.mark.parametrize(
    "arguments",
    [
        ("states", "calvin-c_beso", "--steps", "0"),
        ("states", "calvin-c_beso", "--updates", "0"),
        ("states", "calvin-c_beso", "--trials", "-1"),
        ("bench", "training", "block_push-gcbc", "--seeds-together", "0"),
    ],
)
def test_numbers_below_one_are_refused(arguments):
    with pytest.raises(click.BadParameter, match="is not in the range x>=1"):
        cli.cli(arguments, standalone_mode=False)


def test_a_file_in_the_place_of_a_folder_is_one_line(tmp_path, capsys):
    (tmp_path / "file").touch()
    (tmp_path / "folder").mkdir()
    for path, told in (
        ("file/a", "File exists: "),
        ("file/a/b", "Not a directory: "),
        ("x" * 300, "File name too long: "),
    ):
        with pytest.raises(SystemExit) as ended:
            guard(write_text, tmp_path / path, "text")
        assert ended.value.code == 1
        line = capsys.readouterr().err
        assert line.startswith(f"error: {told}{tmp_path}")
        assert line.count("\n") == 1


def test_any_subfolder_and_the_home_will_do(tmp_path, monkeypatch):
    (tmp_path / "dvc.yaml").touch()
    below = tmp_path / "some/where"
    below.mkdir(parents=True)
    monkeypatch.chdir(below)
    assert cli.find_root() == tmp_path
    assert beso(ROOT / "docs", "check").endswith(", valid\n")

    def seen(value, kind=cli.At):
        return kind().convert(value, None, None)

    monkeypatch.setenv("HOME", "/at/home")
    assert seen("film.webm") == Path("some/where/film.webm")
    assert seen("../../film.webm") == Path("film.webm")
    assert seen("~/film.webm") == Path("/at/home/film.webm")
    monkeypatch.setenv("BESO_SCRATCH", "~/scratch")
    assert scratch.folder("work").parent == Path("/at/home/scratch")
    assert seen(Path("models")) == Path("models"), "a default is the root's"
    assert seen("HEAD", cli.Run) == "HEAD"
    assert seen("../where", cli.Run) == "some/where"


def test_another_run_is_filmed_with_its_own_models(tmp_path):
    run = "reports/published/cpu"
    line = beso(ROOT, "watch", "block_push-c_beso", "--run", run, "--models", "trained", code=1)
    assert line == (
        f"error: --models trained, --run {run}: give one of them; another run is filmed with its own models\n"
    )
    shutil.copyfile(ROOT / "params.yaml", tmp_path / "params.yaml")
    (tmp_path / "dvc.yaml").touch()
    line = beso(tmp_path, "watch", "block_push-c_beso", "--run", str(tmp_path), "--models", "trained", code=1)
    assert line.startswith("error: data/play/block_push is not a play dataset"), "the models are looked for"


def test_a_policy_by_hand_acts_as_the_pipelines(finished, tmp_path):
    """Trained, evaluated and filmed in three commands: the stages' rows."""
    workspace, cell = finished.copy(tmp_path / "workspace"), "block_push-c_beso"
    workspace.machine(workers=1)
    assert workspace.beso("train", cell, "--seed", "1").stdout.endswith(f"all trained: {cell}\n")
    shown = workspace.beso("evaluate", cell, "--seed", "1", "--models", "trained", "--rows", "rows.csv").stdout
    made = pd.read_csv(workspace.folder / "results/block_push/c_beso.csv").query("seed == 1")
    played = pd.read_csv(workspace.folder / "rows.csv")
    pd.testing.assert_frame_equal(played, made.reset_index(drop=True))
    part = made[made["goals"] == "training"]
    told = f"training goals, {len(part)} episodes: Reward {part['reward'].mean():.2f} ("
    assert told in shown
    shown = workspace.beso("watch", cell, "--models", "trained").stdout
    assert f"length {part['length'].iloc[0]}" in shown
    assert (workspace.folder / "watch.webm").stat().st_size > 1000
    done = workspace.beso("evaluate", cell, "--models", "nowhere", check=False)
    assert done.returncode == 1
    assert done.stdout.splitlines()[-1].startswith(f"error: nowhere has no model of {cell}, seed 1: train it first")
