"""The pipeline as its user meets it: `dvc repro` and its relatives, on the smoke profile."""

import importlib
import resource

from beso import envs

from .conftest import Workspace

SAMPLE_STEPS = "methods.c_beso.sample.block_push.steps"
LEARNING_RATE = "methods.gcbc.train.block_push.optimization.learning_rate"


def test_another_clone_with_another_number_of_workers_gives_the_same_bytes(finished, tmp_path, monkeypatch):
    """One method from nothing in every environment: no method runs otherwise than another. Tables: the next test."""
    other = Workspace.fresh(tmp_path)
    other.machine(workers=2)  # the finished one had one for most cells
    monkeypatch.chdir(tmp_path)
    importlib.import_module("stages.resolve").main()
    for env in envs.names():
        raw = ["collect", "preprocess", "features"] if envs.sees_images(env) else ["collect"]
        for stage in (*raw, "trials"):
            importlib.import_module(f"stages.{stage}").main(env)
        for stage in ("train", "evaluate"):
            importlib.import_module(f"stages.{stage}").main(env, "c_beso")
        importlib.import_module("stages.study").main(f"noise_{env}")
    importlib.import_module("stages.fork").main()
    made, theirs = (workspace.files("data", "models", "curves", "results", "films") for workspace in (other, finished))
    assert [str(path) for path in made if made[path] != theirs[path]] == []
    for env in envs.names():
        for folder in ("data/play", "data/trials", "models", "curves", "results", "films"):
            assert any(str(path).startswith(f"{folder}/{env}/") for path in made)


def test_tables_made_again_are_the_same_bytes(small):
    before = small.lock()
    small.repro("--force", "--single-item", "tables")
    assert small.lock() == before


def test_no_change_runs_nothing_in_seconds(finished):
    """Of a processor; DVC reads params.yaml once a stage, which takes three times as long on a busy one."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    assert finished.repro() == []
    assert resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before < 20


def test_a_changed_sampler_reruns_evaluation_and_a_changed_learning_rate_training_of_that_method_only(
    workspace, finished_small, tmp_path
):
    small = finished_small.copy(tmp_path / "small")
    for changed in (workspace, small):
        changed.set(SAMPLE_STEPS, 4)
        changed.set(LEARNING_RATE, 0.002)
    # Methods that are like it sample as it does where they do not say otherwise.
    like_it = ("c_beso", "cfg_beso", "c_beso_film", "cfg_beso_element", "c_beso_log_normal")
    cells = {f"evaluate@block_push-{name}" for name in like_it}
    # Studies of samplers choose the number of steps themselves.
    names = ("noise", "schedules", "context", "guidance", "guidance_element")
    studies = {f"study@{name}_block_push" for name in names}
    stale = {*cells, *studies, "train@block_push-gcbc", "tables", "page"}
    assert workspace.stale() == stale
    assert set(small.repro()) == (stale | {"evaluate@block_push-gcbc"}) & small.stages(), "what follows, too"


def test_a_change_in_a_methods_file_reruns_that_method_only(workspace, finished_small, tmp_path):
    small = finished_small.copy(tmp_path / "small")
    for changed in (workspace, small):
        path = changed.folder / "beso/methods/gcbc.py"
        path.write_text(path.read_text() + "\n# changed\n")
    cells = {f"{stage}@{env}-gcbc" for stage in ("train", "evaluate") for env in envs.names()}
    kinds = ("train", "evaluate", "study")
    assert workspace.stale(*kinds) == cells
    assert set(small.repro(*kinds)) == cells & small.stages()


def test_machine_settings_rerun_nothing(small):
    small.machine(workers=2)
    assert small.repro() == []


def test_one_stage_can_be_rerun_by_name(small):
    before = small.files("models")
    assert small.repro("train@block_push-c_beso") == []
    assert small.repro("--force", "--single-item", "train@block_push-c_beso") == ["train@block_push-c_beso"]
    assert small.files("models") == before


def test_diffs_name_what_changed(small):
    small.set(LEARNING_RATE, 0.002)
    small.set("environments.block_push.evaluation.max_actions", 5)
    shown = small.dvc("params", "diff").stdout
    assert LEARNING_RATE in shown
    assert "0.002" in shown
    for stage in ("train", "evaluate"):  # this cell alone; `dvc repro` would play those of all methods
        small.stage(stage, "block_push", "gcbc")
    small.stage("tables")
    shown = small.dvc("metrics", "diff").stdout
    (line, *_) = [line for line in shown.splitlines() if "reports/metrics/block_push/gcbc/training.json" in line]
    assert line.split()[1] == "length"
    shown = small.dvc("metrics", "show").stdout.splitlines()
    assert shown[0].split() == ["Path", "length", "result", "result_std", "reward", "reward_std"]
    assert len(shown) == 1 + 2 * len(list((small.folder / "reports/metrics/block_push").iterdir())), "goal sets"
    assert max(map(len, shown)) < 120


def test_plots_show_the_training_curves(small):
    small.dvc("plots", "show")
    page = (small.folder / "dvc_plots/index.html").read_text()
    assert "validation_loss" in page
    assert "training_loss" in page


def test_results_can_be_shared_through_a_remote(finished_small, small, tmp_path):
    remote = tmp_path / "remote"
    small.dvc("remote", "add", "--default", "storage", str(remote))
    small.commit()
    small.dvc("push")
    clone = tmp_path / "clone"
    small.run("git", "clone", "-q", str(small.folder), str(clone))
    other = Workspace(clone)
    other.dvc("pull")
    assert other.files("data", "models", "results") == finished_small.files("data", "models", "results")
    assert other.repro() == []


def test_a_reverted_parameter_is_restored_without_running(small):
    before = small.files("models", "results")
    small.set(LEARNING_RATE, 0.002)
    small.repro("evaluate@block_push-gcbc")
    assert small.files("models", "results") != before
    small.set(LEARNING_RATE, 0.001)
    assert small.repro("evaluate@block_push-gcbc") == []
    assert small.files("models", "results") == before
