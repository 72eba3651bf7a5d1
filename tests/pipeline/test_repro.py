"""The pipeline as its user meets it: `dvc repro` and its relatives, on the smoke profile."""

import resource

from beso import envs

from .conftest import Workspace

SAMPLE_STEPS = "methods.c_beso.sample.block_push.steps"
LEARNING_RATE = "methods.gcbc.train.block_push.optimization.learning_rate"


def test_another_clone_with_another_number_of_workers_gives_the_same_bytes(finished, tmp_path):
    """One method from nothing on every environment: no method runs otherwise than another."""
    other = Workspace.fresh(tmp_path)
    other.set("machine.workers", 2)  # the finished one had one for most cells
    stages = [f"{stage}@{env}-c_beso" for stage in ("evaluate", "film") for env in envs.names()]
    studies = [f"study@noise_{env}" for env in envs.names()]
    other.python("-m", "pipeline.run", "-j", "2", *stages, *studies)
    ours, theirs = finished.lock(), other.lock()
    assert len(theirs) > len(stages) + len(studies)
    assert [path for path in theirs if ours[path] != theirs[path]] == []


def test_tables_made_again_are_the_same_bytes(workspace):
    before = workspace.lock()
    workspace.repro("--force", "--single-item", "tables")
    assert workspace.lock() == before


def test_no_change_runs_nothing_in_seconds(finished):
    """Of a processor; DVC reads params.yaml once a stage, which takes three times as long on a busy one."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    assert finished.repro() == []
    assert resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before < 20


def test_a_changed_sampler_reruns_evaluation_and_a_changed_learning_rate_training_of_that_method_only(workspace):
    workspace.set(SAMPLE_STEPS, 4)
    workspace.set(LEARNING_RATE, 0.002)
    # Its variants sample as it does where they do not say otherwise.
    cells = {f"evaluate@block_push-{name}" for name in ("c_beso", "c_beso_film", "c_beso_log_normal")}
    names = ("samplers", "samplers_log_normal", "noise", "schedules", "context")
    studies = {f"study@{name}_block_push" for name in names}
    trained = {"train@block_push-gcbc", "evaluate@block_push-gcbc"}
    assert set(workspace.repro()) == {*cells, *studies, *trained, "film@block_push-c_beso", "tables", "page"}


def test_a_change_in_a_methods_file_reruns_that_method_only(workspace):
    path = workspace.folder / "beso/methods/gcbc.py"
    path.write_text(path.read_text() + "\n# changed\n")
    cells = {f"{stage}@{env}-gcbc" for stage in ("train", "evaluate") for env in envs.names()}
    assert set(workspace.repro("train", "evaluate", "study", "film")) == cells


def test_machine_settings_rerun_nothing_but_the_page(workspace):
    workspace.set("machine.workers", 1)
    assert workspace.repro() == ["page"]  # it prints params.yaml


def test_one_stage_can_be_rerun_by_name(workspace):
    before = workspace.files("models")
    assert workspace.repro("train@block_push-c_beso") == []
    assert workspace.repro("--force", "--single-item", "train@block_push-c_beso") == ["train@block_push-c_beso"]
    assert workspace.files("models") == before


def test_diffs_name_what_changed(workspace):
    workspace.set(LEARNING_RATE, 0.002)
    workspace.set("environments.block_push.evaluation.max_actions", 5)
    shown = workspace.dvc("params", "diff").stdout
    assert LEARNING_RATE in shown
    assert "0.002" in shown
    for stage in ("train", "evaluate"):  # this cell alone; `dvc repro` would play those of all methods
        workspace.python("-m", f"stages.{stage}", "block_push", "gcbc")
    workspace.python("-m", "stages.tables")
    shown = workspace.dvc("metrics", "diff").stdout
    assert "block_push.gcbc.training_goals.length" in shown


def test_plots_show_the_training_curves(workspace):
    workspace.dvc("plots", "show")
    page = (workspace.folder / "dvc_plots/index.html").read_text()
    assert "validation_loss" in page
    assert "training_loss" in page


def test_results_can_be_shared_through_a_remote(finished, workspace, tmp_path):
    remote = tmp_path / "remote"
    workspace.dvc("remote", "add", "--default", "storage", str(remote))
    workspace.commit()
    workspace.dvc("push")
    clone = tmp_path / "clone"
    workspace.run("git", "clone", "-q", str(workspace.folder), str(clone))
    other = Workspace(clone)
    other.dvc("pull")
    assert other.files("data", "models", "results") == finished.files("data", "models", "results")
    assert other.repro() == []


def test_a_reverted_parameter_is_restored_without_running(workspace):
    before = workspace.files("models", "results")
    workspace.set(LEARNING_RATE, 0.002)
    workspace.repro("evaluate@block_push-gcbc")
    assert workspace.files("models", "results") != before
    workspace.set(LEARNING_RATE, 0.001)
    assert workspace.repro("evaluate@block_push-gcbc") == []
    assert workspace.files("models", "results") == before
