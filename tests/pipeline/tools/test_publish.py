"""Archives of the smoke run: whole, in parts, and used without the run."""

import json
import shutil
import subprocess
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import safetensors.torch

from beso import envs
from beso.core import checkpoint
from beso.data import play
from beso.errors import UserError
from beso.files import read_json
from beso.policy import EVALUATION, Policy
from pipeline.machine import Machine
from pipeline.params import PATH, load
from pipeline.recipes import read_environment
from pipeline.report import figures
from pipeline.settings import Features
from pipeline.tools import publish
from pipeline.tools.archive import held, parts
from pipeline.tools.import_cells import import_cells
from stages.evaluate import evaluate_cell
from stages.features import make_features
from stages.train import train_cell

COMMITTED = sorted((Path(__file__).parents[3] / publish.FOLDER).iterdir())
COMMITTED_WEIGHTS = [
    path.relative_to(COMMITTED[0].parent) for run in COMMITTED for path in run.glob("models/*/*/*.safetensors")
]
ARCHIVE = "reports/published/smoke"
MODELS = [("block_push", 1), ("block_push", 2), ("calvin", 1), ("kitchen", 1)]
WEIGHTS = [f"models/{environment}/c_beso/seed{seed}.safetensors" for environment, seed in MODELS]
ENCODER = "data/play/calvin/encoder.safetensors"
FEATURES = "data/play/calvin/observations.safetensors"


@pytest.fixture(scope="module")
def archived(finished, tmp_path_factory):
    """The finished smoke run with an archive of all of it."""
    workspace = finished.copy(tmp_path_factory.mktemp("archived") / "workspace")
    workspace.beso("publish", "--weights", "c_beso")
    return workspace


@pytest.fixture(scope="module")
def archived_small(finished_small, tmp_path_factory):
    """The small finished workspace with an archive of all of it."""
    workspace = finished_small.copy(tmp_path_factory.mktemp("archived_small") / "workspace")
    workspace.beso("publish")
    return workspace


def contents(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def not_run(folder):
    """Cells of the paper's main table of which a folder's comparison has nothing."""
    table = pd.read_csv(folder / "comparison.csv").query("place == 'Table I' and verdict == 'not run'")
    return set(zip(table["environment"], table["method"], strict=True))


@pytest.mark.parametrize("archive", COMMITTED, ids=lambda archive: archive.name)
def test_todays_code_knows_the_parameters_and_models_of_a_committed_archive(archive):
    params = load(archive / PATH)
    descriptions = sorted(archive.glob("models/*/*/seed*.json"))
    assert descriptions
    for description in descriptions:
        environment, method = description.parts[-3:-1]
        seed = int(description.stem.removeprefix("seed"))
        cell = params.cell(environment, method)
        checkpoint.check(description.parent, replace(cell.train.first, seed=seed))
        evaluated = {"env": environment, "sampling": asdict(cell.evaluate.sampling)}
        assert read_json(description.parent / EVALUATION) == json.loads(json.dumps(evaluated))


@pytest.mark.parametrize("weights", COMMITTED_WEIGHTS, ids=str)
def test_policies_of_a_committed_archive_are_sampled_as_they_were_evaluated(weights):
    folder = COMMITTED[0].parent / weights.parent
    archive, _, environment, method = weights.parent.parts
    policy = Policy.load(folder, device="cpu")
    assert policy.sampling == load(COMMITTED[0].parent / archive / PATH).cell(environment, method).evaluate.sampling
    assert policy.spec.environment == environment
    assert policy.spec.observation_shape == (envs.spec(environment).observation_size,)


def test_the_archive_of_a_whole_run_has_the_tables_of_the_run(archived):
    archive, reports = archived.folder / ARCHIVE, archived.folder / "reports"
    for name in ("README.md", "tables.tex", "comparison.csv"):
        assert (archive / name).read_bytes() == (reports / name).read_bytes()
    for name in ("figures", "metrics"):
        assert contents(archive / name) == contents(reports / name)
    assert "do not differ: the same in all" in archived.beso("compare", ARCHIVE, ".").stdout


def test_archives_keep_the_weights_that_were_asked_for_and_git_takes_them(archived):
    archive = archived.folder / ARCHIVE
    kept = sorted(path.relative_to(archive).as_posix() for path in archive.rglob("*.safetensors"))
    assert kept == sorted([*WEIGHTS, ENCODER, FEATURES])
    assert (archive / "models/kitchen/gcbc/seed1.json").is_file(), "descriptions of all models"
    archived.run("git", "add", ARCHIVE)
    listed = archived.run("git", "ls-files", ARCHIVE).stdout.split()
    assert len(listed) == len(contents(archive))
    assert sum(map(len, contents(archive).values())) < 8e6


def test_an_archive_grows_in_sittings_to_the_same_bytes(archived, tmp_path, monkeypatch):
    first, second = archived.copy(tmp_path / "first"), archived.copy(tmp_path / "second")
    whole = contents(archived.folder / ARCHIVE)
    for workspace in (first, second):
        shutil.rmtree(workspace.folder / ARCHIVE)
    monkeypatch.chdir(first.folder)
    with monkeypatch.context() as context:
        context.setattr(figures, "save", lambda *_: None)  # most of the time, and the second sitting replaces them
        publish.publish(["kitchen", "fork"], ["c_beso"], [])
    missing = not_run(first.folder / ARCHIVE) - not_run(first.folder / "reports")
    assert {environment for environment, _ in missing} == {"block_push"}
    assert {"gcbc", "c_beso"} <= {method for _, method in missing}
    # Of the first sitting, the second has what git tracks.
    shutil.copytree(first.folder / ARCHIVE, second.folder / ARCHIVE)
    for folder in ("data/play", "data/trials", "models", "results"):
        shutil.rmtree(second.folder / folder / "kitchen")
    (second.folder / "results/fork.csv").unlink()
    second.beso("publish", "--weights", "c_beso")
    assert contents(second.folder / ARCHIVE) == whole


def refused(workspace, monkeypatch, *names, weights=(), drop=()):
    monkeypatch.chdir(workspace.folder)
    before = contents(workspace.folder / ARCHIVE)
    with pytest.raises(UserError) as error:
        publish.publish(names, weights, drop)
    assert contents(workspace.folder / ARCHIVE) == before
    return str(error.value)


def test_cells_of_other_parameters_or_data_do_not_stand_side_by_side(archived_small, tmp_path, monkeypatch):
    workspace = archived_small.copy(tmp_path / "workspace")
    record = workspace.folder / ARCHIVE / "results/block_push/gcbc.json"
    made = json.loads(record.read_text())
    record.write_text(json.dumps(made | {"data": "another"}))
    line = refused(workspace, monkeypatch, "evaluate@block_push-c_beso")
    assert line.startswith(f"{ARCHIVE} has evaluate@block_push-gcbc of other data: data 'another' there and '")
    record.write_text(json.dumps(made))
    workspace.set("environments.block_push.evaluation.seed", 7)
    assert refused(workspace, monkeypatch) == (
        f"{ARCHIVE} has evaluate@block_push-gcbc of other parameters: evaluate.evaluation.seed is 1000"
        " there and 7 here; archive it anew, or drop it:"
        " `beso publish --drop evaluate@block_push-gcbc`"
    )
    line = refused(workspace, monkeypatch, "block_push")
    assert line.startswith("block_push is not finished: run `beso run evaluate@block_push-gcbc ")


def test_a_dropped_cell_is_not_run(archived_small, tmp_path, monkeypatch):
    workspace = archived_small.copy(tmp_path / "workspace")
    monkeypatch.chdir(workspace.folder)
    publish.publish([], [], ["evaluate@block_push-gcbc"])
    archive = workspace.folder / ARCHIVE
    assert not list(archive.rglob("*block_push/gcbc*"))
    assert not_run(archive) - not_run(workspace.folder / "reports") == {("block_push", "gcbc")}
    line = refused(workspace, monkeypatch, drop=["evaluate@block_push-gcbc"])
    assert line.startswith(f"--drop evaluate@block_push-gcbc: {ARCHIVE} has evaluate@block_push-c_beso, ")
    assert "study@samplers_block_push is of cell block_push-c_beso, which is not archived" in refused(
        workspace, monkeypatch, drop=["evaluate@block_push-c_beso"]
    )


def test_what_is_dropped_is_not_beside_what_is_added():
    for names, weights in ((["kitchen"], []), ([], ["c_beso"])):
        with pytest.raises(UserError, match="--drop takes out and adds nothing"):
            publish.publish(names, weights, ["fork"])


@pytest.mark.parametrize(
    ("names", "options", "message"),
    [
        (("moon",), {}, "'moon' is neither an environment nor one of evaluate@block_push-gcbc, "),
        ((), {"weights": ["sac"]}, "--weights sac: params.yaml has the methods gcbc, "),
        ((), {"drop": ["moon"]}, f"--drop moon: {ARCHIVE} has evaluate@block_push-gcbc, "),
    ],
)
def test_unknown_names_are_one_line(archived, monkeypatch, names, options, message):
    assert refused(archived, monkeypatch, *names, **options).startswith(message)


def test_an_archive_that_a_kill_left_under_another_name_is_put_back(tmp_path, capsys):
    """Between the two renames of beso.files.replacing."""
    number = subprocess.run(["sh", "-c", "echo $$"], capture_output=True, text=True).stdout.strip()  # of a dead process
    left = [tmp_path / f".smoke.{number}.{kind}" for kind in ("old", "partial")]
    for folder in (*left, tmp_path / ".smoke.1.partial"):
        folder.mkdir()
        (folder / "rows").write_text(folder.name)
    publish.recover(tmp_path / "smoke")
    assert (tmp_path / "smoke/rows").read_text() == left[0].name
    assert "put back" in capsys.readouterr().out
    left[0].mkdir()
    publish.recover(tmp_path / "smoke")
    assert sorted(path.name for path in tmp_path.iterdir()) == [".smoke.1.partial", "smoke"], "of the living, nothing"


def test_a_cell_that_is_filmed_since_it_was_archived_is_archived_anew(tmp_path):
    archive = shutil.copytree(next(run for run in COMMITTED if run.name == "cpu"), tmp_path / "cpu")
    params = load(archive / PATH)
    cell = params.cells["calvin-ril"]
    filmed = replace(cell, evaluate=replace(cell.evaluate, film=True))
    params = replace(params, cells=params.cells | {cell.name: filmed})
    with pytest.raises(UserError, match=r"ril\.npy is missing: archive it anew, `beso publish evaluate@cal"):
        publish.write(archive, params, held(archive, parts(params)), [], [])


def test_archives_without_records_are_refused(archived, tmp_path, monkeypatch):
    workspace = archived.copy(tmp_path / "workspace")
    (workspace.folder / ARCHIVE / "results/kitchen/gcbc.json").unlink()
    assert "was archived by an older version: remove it" in refused(workspace, monkeypatch)


def test_too_large_weights_are_left_out(archived, tmp_path, capsys):
    archive = shutil.copytree(archived.folder / ARCHIVE, tmp_path / "archive")
    encoder = archive / ENCODER
    with encoder.open("ab") as file:
        file.truncate(publish.LARGEST + 1)
    publish.limit_weights(archive)
    told = capsys.readouterr().out
    assert told == f"weights of calvin c_beso are left out: {ENCODER} has 2,000,001 bytes, more than 2,000,000\n"
    assert [(archive / name).exists() for name in (*WEIGHTS, ENCODER)] == [True, True, False, True, False]


def test_policies_of_an_archive_act_as_they_did(archived):
    for environment in ("block_push", "kitchen"):
        folder = f"models/{environment}/c_beso"
        stored = safetensors.torch.load_file(archived.folder / ARCHIVE / folder / "seed1.safetensors")
        assert {str(value.dtype) for value in stored.values()} <= {"torch.float16", "torch.int64"}
        policies = [Policy.load(archived.folder / root / folder, device="cpu") for root in ("", ARCHIVE)]
        evaluated = read_json(archived.folder / f"recipes/evaluate/{environment}/c_beso.json")["sampling"]
        assert [asdict(policy.sampling) for policy in policies] == [evaluated, evaluated]
        data = archived.folder / "data/play" / environment
        observations, actions = (np.load(data / f"{name}.npy") for name in ("observations", "actions"))
        acted = []
        for policy in policies:
            policy.reset(observations[-envs.spec(environment).goal_window :])
            acted.append(np.stack([policy.act(observation) for observation in observations[:20]]))
        assert not np.array_equal(*acted)
        assert np.abs(acted[0] - acted[1]).max() < 0.02 * (actions.max() - actions.min())


def test_a_clone_watches_the_archive_without_the_run(archived, tmp_path):
    workspace = archived.copy(tmp_path / "workspace")
    for folder in ("data", "models", "curves", "results", "films"):
        shutil.rmtree(workspace.folder / folder)
    (workspace.folder / "params.yaml").unlink()
    for environment in ("block_push", "calvin"):
        workspace.beso("watch", f"{environment}-c_beso", "--run", ARCHIVE, "--episode", "1")
        assert (workspace.folder / "watch.webm").stat().st_size > 1000
        (workspace.folder / "watch.webm").unlink()
    done = workspace.beso("watch", "block_push-gcbc", "--run", ARCHIVE, check=False)
    assert done.returncode == 1
    assert f"{ARCHIVE}/models/block_push/gcbc/seed1.safetensors was not archived: {ARCHIVE}/" in done.stdout


def test_policies_that_see_pictures_are_taken_where_features_differ_in_last_bits(
    archived, tmp_path, monkeypatch, capsys
):
    workspace = archived.copy(tmp_path / "workspace")
    monkeypatch.chdir(workspace.folder)
    cell = load().cell_named("calvin-c_beso")

    def told():
        import_cells(Path(ARCHIVE))
        return [line for line in capsys.readouterr().out.splitlines() if line.startswith("calvin")]

    encoder = "calvin, encoder: taken; run `dvc repro --force --single-item features@calvin`, then import again"
    assert told()[0] == encoder  # in half precision it is another one
    make_features(read_environment(Features, "features", "calvin"), Machine.load())
    capsys.readouterr()
    assert told() == ["calvin-c_beso: all seeds; run `dvc repro --force --single-item train@calvin-c_beso`"]
    train_cell(cell.train, Machine.load())
    evaluate_cell(cell.evaluate, Machine.load())  # refuses models of other play data

    # Archived again, beside cells of the archive's own features.
    monkeypatch.setattr(publish, "plan", lambda _: {})
    monkeypatch.setattr(figures, "save", lambda *_: None)
    before = contents(Path(ARCHIVE))
    publish.publish(["evaluate@calvin-c_beso"], ["c_beso"], [])
    after = contents(Path(ARCHIVE))
    kept = [name for name in before if name.parts[0] in ("data", "results", "models") and "c_beso" not in name.name]
    assert [name for name in kept if after[name] != before[name]] == []
    assert "calvin-c_beso: all seeds; run" in told()[-1]
    for name in (ENCODER, "models/calvin/c_beso/seed1.safetensors"):  # as an archive that keeps no weights
        (Path(ARCHIVE) / name).unlink()
    publish.publish(["evaluate@calvin-c_beso"], ["c_beso"], [])
    assert contents(Path(ARCHIVE)) == after

    play_data = play.load(cell.play, envs.spec("calvin"))
    features = play_data.observations * np.linspace(1, 1.5, len(play_data.observations), dtype=np.float32)[:, None]
    play.save(replace(play_data, observations=features), cell.play)
    assert told()[-1] == "calvin-c_beso: dvc repro would train seeds 1 here"
    told_other = refused(workspace, monkeypatch, "evaluate@calvin-c_beso")
    assert told_other.startswith(f"{ARCHIVE} has evaluate@calvin-gcbc of other data")
