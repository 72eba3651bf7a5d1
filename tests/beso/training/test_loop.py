import dataclasses
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import safetensors.torch
import torch

import beso
from beso import methods
from beso.config import build
from beso.core import checkpoint
from beso.core.seeding import torch_generator
from beso.core.training_config import OptimizationConfig, ValidationConfig
from beso.data.scaling import Scaling
from beso.data.windows import WindowConfig, Windows
from beso.errors import UserError
from beso.training import loop as training

CPU = torch.device("cpu")


@pytest.fixture
def run(dataset, spec, tmp_path, teacher_of):
    """run(job, state file) -> what training makes of the small dataset."""
    teachers = {}

    def run(job, state=None, save_seconds=math.inf):
        key = (job.method, job.seed)
        if key not in teachers:
            teachers[key] = teacher_of(job)
        state = state or tmp_path / "unused"
        return training.train(job, dataset, spec, CPU, state, save_seconds, teacher=teachers[key])

    return run


def weights_bytes(trained):
    return safetensors.torch.save(trained.weights)


class Killed(BaseException):
    """Stands for a kill: nothing catches it."""


@pytest.fixture
def kill_at(monkeypatch):
    """kill_at(n): the n-th batch from now on is never drawn."""
    original = Windows.sample

    def arm(call):
        calls = iter(range(1, call + 1))

        def sample(self, size, generator):
            if size == 4 and next(calls) == call:  # the jobs' batch size; validation draws 6
                raise Killed
            return original(self, size, generator)

        monkeypatch.setattr(Windows, "sample", sample)

    yield arm
    monkeypatch.setattr(Windows, "sample", original)


@pytest.mark.parametrize("optimizer", ["adam", "adamw", "muon"])
@pytest.mark.parametrize("name", methods.names())
def test_a_killed_run_continues_to_the_same_bytes(run, make_job, tmp_path, kill_at, name, optimizer):
    job, state = make_job(name, optimizer=optimizer), tmp_path / "state"
    undisturbed = run(job)
    assert not (tmp_path / "unused").exists(), "a short run saves no state"

    for more_steps in (3, 4):  # killed before step 3, then before step 6: once before a measurement, once after
        kill_at(more_steps)
        with pytest.raises(Killed):
            run(job, state, save_seconds=0)
    kill_at(1000)
    resumed = run(job, state)
    assert weights_bytes(resumed) == weights_bytes(undisturbed)
    assert resumed.curve == undisturbed.curve
    assert resumed.scaling == undisturbed.scaling


def test_steps_after_the_last_saved_state_are_repeated_exactly(run, make_job, tmp_path, kill_at):
    job, state = make_job("cfg_beso"), tmp_path / "state"
    undisturbed = run(job)
    kill_at(3)
    with pytest.raises(Killed):
        run(job, state, save_seconds=0)
    saved = state.read_bytes()
    kill_at(4)
    with pytest.raises(Killed):
        run(job, state)
    assert state.read_bytes() == saved
    kill_at(1000)
    assert weights_bytes(run(job, state)) == weights_bytes(undisturbed)


def test_a_finished_state_gives_the_same_model_without_training(run, make_job, tmp_path, kill_at):
    finished = run(make_job(), tmp_path / "state", save_seconds=0)
    kill_at(1)
    again = run(make_job(), tmp_path / "state")
    assert weights_bytes(again) == weights_bytes(finished)
    assert again.curve == finished.curve


@pytest.mark.parametrize("name", methods.names())
def test_two_runs_are_the_same_bytes_and_two_seeds_are_not(run, make_job, name):
    torch.manual_seed(1)
    first = run(make_job(name))
    torch.manual_seed(2)
    second, other = run(make_job(name)), run(make_job(name, seed=2))
    assert weights_bytes(first) == weights_bytes(second)
    assert first.curve == second.curve
    assert weights_bytes(first) != weights_bytes(other)
    assert first.scaling != other.scaling, "every seed has its own split"


@pytest.mark.parametrize("name", ["gcbc", "cfg_beso"])
def test_validation_does_not_disturb_training(run, make_job, name):
    often, seldom = run(make_job(name, every=1)), run(make_job(name, every=100))
    assert weights_bytes(often) == weights_bytes(seldom)
    assert [row["step"] for row in often.curve] == list(range(1, 9))
    assert [row["step"] for row in seldom.curve] == [8]
    assert often.curve[-1]["validation_loss"] == seldom.curve[-1]["validation_loss"]
    # The training loss is a mean since the last measurement.
    mean = np.mean([row["training_loss"] for row in often.curve])
    assert seldom.curve[0]["training_loss"] == pytest.approx(mean, rel=1e-5)


def test_measurements_come_at_their_interval_and_after_the_last_step(run, make_job):
    curve = run(make_job("gcbc", every=3)).curve
    assert [row["step"] for row in curve] == [3, 6, 8]
    assert all(math.isfinite(value) for row in curve for value in row.values())


def plain_training(job, dataset, spec):
    """The loop in its simplest form: the weights after every step, for a constant rate and Adam."""
    episodes, _ = job.split(len(dataset))
    scaling = Scaling.fit(dataset, episodes, spec)
    model = job.config.model
    windows = Windows(dataset, episodes, scaling, WindowConfig(model.window, spec.goal_window))
    initial = torch_generator(job.root_seed, "initial weights", job.seed)
    method = methods.load(job.method).Method(model, None, spec.sizes, initial).train()
    # Fused like the loop's own: the biases of the keys have no gradient but rounding, which Adam blows up to full size.
    optimizer = torch.optim.Adam(method.parameters(), job.config.optimization.learning_rate, fused=True)
    draws, history = torch_generator(job.root_seed, "training", job.seed), []
    history.append({key: value.clone() for key, value in method.state_dict().items()})
    for _ in range(job.config.optimization.steps):
        optimizer.zero_grad()
        method.loss(windows.sample(job.config.optimization.batch_size, draws), draws).backward()
        optimizer.step()
        history.append({key: value.clone() for key, value in method.state_dict().items()})
    return history


@pytest.mark.parametrize("ema_decay", [0.0, 0.3, 0.999])
def test_saved_weights_are_the_average_with_warm_up(run, make_job, dataset, spec, ema_decay):
    """Decay min(ema_decay, (1 + n) / (10 + n)) at step n = 0, 1, ...; of 0 the last weights remain."""
    constant = {"schedule": "constant", "weight_decay": 0.0}
    job = make_job("c_beso", ema_decay=ema_decay, **constant)
    history = plain_training(job, dataset, spec)
    average = history[0]
    for n, weights in enumerate(history[1:]):
        decay = min(ema_decay, (1 + n) / (10 + n))
        average = {key: decay * average[key] + (1 - decay) * weights[key] for key in weights}
    trained = run(job)
    for key, value in trained.weights.items():
        assert torch.allclose(value, average[key], atol=1e-6), key  # updates are 1e-3 each


def test_training_reduces_the_loss(run, make_job):
    job = make_job("gcbc", every=100, steps=200, batch_size=32, ema_decay=0.0, model={"dropout": 0.0})
    curve = run(job).curve
    assert curve[-1]["training_loss"] < 0.5 * curve[0]["training_loss"]


def test_statistics_come_from_the_training_episodes_alone(run, make_job, dataset, spec):
    job = make_job("gcbc")
    episodes, held_out = job.split(len(dataset))
    assert sorted([*episodes, *held_out]) == list(range(len(dataset)))
    assert run(job).scaling == Scaling.fit(dataset, episodes, spec)


def test_a_window_that_does_not_fit_the_data_is_refused(run, make_job, small_models):
    transformer = {**small_models["c_beso"][0]["transformer"], "window": 30}
    with pytest.raises(UserError, match="window = 30: the shortest episode has"):
        run(make_job("c_beso", model={"transformer": transformer}), save_seconds=0)


def test_models_in_turns_have_the_bytes_that_they_have_alone(run, make_job, dataset, spec, tmp_path):
    """Of different methods and lengths, one of them continued; a finished one leaves the others to go on."""
    jobs = [make_job("c_beso"), make_job("lmp", seed=2, steps=5), make_job("c_beso", seed=3)]
    alone = [run(job) for job in jobs]
    made = [training.Training(job, dataset, spec, CPU, tmp_path / f"{i}") for i, job in enumerate(jobs)]
    made[2].step()
    finished = list(training.side_by_side(made))
    assert finished == [made[1], made[2], made[0]]
    for together, one in zip(made, alone, strict=True):
        assert weights_bytes(together.result()) == weights_bytes(one)
        assert together.result().curve == one.curve


def test_models_in_turns_are_saved_when_time_is_over(run, make_job, dataset, spec, tmp_path):
    jobs = [make_job("gcbc"), make_job("gcbc", seed=2, steps=1)]

    def begin():
        return [training.Training(job, dataset, spec, CPU, tmp_path / f"{i}") for i, job in enumerate(jobs)]

    first = begin()
    assert list(training.side_by_side(first, until=-math.inf)) == [first[1]]
    second = begin()
    assert [made.done for made in second] == [1, 1]
    assert len(list(training.side_by_side(second))) == 2
    assert [weights_bytes(made.result()) for made in second] == [weights_bytes(run(job)) for job in jobs]


@pytest.mark.parametrize("name", methods.names())
def test_bfloat16_autocast_trains(run, make_job, name):
    trained = run(make_job(name, precision="bf16"))
    assert all(value.dtype == torch.float32 and value.isfinite().all() for value in trained.weights.values())


@pytest.mark.parametrize("precision", ["fp32", "bf16"])
def test_auto_trains_in_the_precision_that_the_device_is_fast_at(run, make_job, spec, tmp_path, monkeypatch, precision):
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: {"amx_bf16": precision == "bf16"})
    job = make_job("c_beso", precision="auto")
    trained = run(job)
    assert weights_bytes(trained) == weights_bytes(run(make_job("c_beso", precision=precision)))
    checkpoint.save(tmp_path, job, spec.sizes, trained, "digest")
    assert checkpoint.load_description(tmp_path, job.seed)["precision"] == precision


def test_a_film_model_can_save_its_state(run, make_job, small_models):
    transformer = {**small_models["c_beso"][0]["transformer"], "conditioning": "film"}
    run(make_job("c_beso", model={"transformer": transformer}), save_seconds=0)


# Configuration

OPTIMIZATION = {
    "steps": 1000,
    "batch_size": 8,
    "optimizer": "adam",
    "learning_rate": 1e-3,
    "weight_decay": 0.0,
    "schedule": "constant",
    "ema_decay": 0.999,
    "precision": "fp32",
}


def rates(schedule, steps):
    config = build(OptimizationConfig, {**OPTIMIZATION, "schedule": schedule}, "optimization")
    return [config.learning_rate_at(step) for step in steps]


def test_learning_rate_schedules():
    assert rates("constant", [0, 500, 999]) == [1e-3] * 3
    assert rates("cosine", [0, 250, 500, 999]) == pytest.approx(
        [1e-3, 1e-3 * (1 + math.sqrt(0.5)) / 2, 5e-4, 1e-3 * (math.pi / 1000) ** 2 / 4], rel=1e-5
    )
    assert rates("step", [0, 99, 100, 199, 200]) == pytest.approx([1e-3, 1e-3, 9.9e-4, 9.9e-4, 9.801e-4])


def test_the_published_step_schedule_ends_where_its_authors_did():
    """1e-4 times 0.99 every 100 steps is 1.8e-6 after 40,000 and 2.4e-7 after 60,000."""
    config = build(OptimizationConfig, {**OPTIMIZATION, "learning_rate": 1e-4, "schedule": "step"}, "optimization")
    assert config.learning_rate_at(40_000) == pytest.approx(1.8e-6, abs=0.05e-6)
    assert config.learning_rate_at(60_000) == pytest.approx(2.4e-7, abs=0.05e-7)


def test_training_uses_the_schedule(run, make_job):
    job = make_job("gcbc", every=1, schedule="cosine")
    expected = [job.config.optimization.learning_rate_at(step) for step in range(8)]
    assert [row["learning_rate"] for row in run(job).curve] == expected


@pytest.mark.parametrize(
    "changes",
    [{"steps": 0}, {"batch_size": 0}, {"learning_rate": 0}, {"weight_decay": -1}, {"ema_decay": 1}, {"schedule": "x"}],
)
def test_impossible_optimization_is_refused(changes):
    with pytest.raises(UserError, match=f"{next(iter(changes))} = "):
        build(OptimizationConfig, {**OPTIMIZATION, **changes}, "optimization")


def test_impossible_validation_is_refused():
    for changes in ({"every": 0, "windows": 1}, {"every": 1, "windows": 0}):
        with pytest.raises(UserError, match="must be at least 1"):
            build(ValidationConfig, changes, "validation")


def test_a_job_is_plain_data_for_json_and_fingerprints(make_job):
    values = dataclasses.asdict(make_job("cfg_beso"))
    assert values["config"]["model"]["transformer"]["width"] == 32
    assert values["config"]["optimization"]["optimizer"] == "adam"


def test_the_average_remembers_no_updates(run, make_job, monkeypatch):
    """Nothing of one update may stay in memory after the next."""
    method, gradients = methods.load("c_beso").Method, []
    loss = method.loss

    def noted(self, batch, generator):
        if not self.training:  # the average, on held-out windows
            gradients.extend(parameter.requires_grad for parameter in self.parameters())
        return loss(self, batch, generator)

    monkeypatch.setattr(method, "loss", noted)
    run(make_job("c_beso"))
    assert gradients
    assert not any(gradients)


def test_training_imports_no_sampler(make_job):
    """What trains does not depend on samplers and guidance: a cell retrains for its own reasons alone."""
    code = """
import sys
from beso import methods
from beso.training import loop as training
from beso.config import build
from beso.core import checkpoint
methods.load("c_beso"), methods.load("cfg_beso"), methods.load("cx_diff")
print([name for name in sys.modules if name.startswith("beso.sampling")])
"""
    root = Path(beso.__file__).parent.parent
    result = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=False)
    assert result.stdout == "[]\n", result.stderr


def test_imports_where_little_is_installed():
    """A GPU machine may have torch, numpy, safetensors and tqdm alone; only C-BeT's clusters need scikit-learn."""
    code = """
import sys

import numpy.random, safetensors.torch, torch, tqdm

sys.modules["gymnasium"] = None  # as where it is not installed
before = set(sys.modules)
from beso import envs, methods, policy
from beso.core import checkpoint
from beso.training import loop as training
for name in methods.names():
    methods.load(name)
for name in envs.names():
    envs.spec(name)
new = {name.split(".")[0] for name in set(sys.modules) - before} - set(sys.stdlib_module_names)
print(sorted(new - {"torch", "numpy"}), len(methods.names()))
"""
    root = Path(beso.__file__).parent.parent
    result = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=False)
    assert result.stdout == f"['beso'] {len(methods.names())}\n", result.stderr


def test_a_model_that_diverges_in_its_last_update_is_not_saved(dataset, spec, make_job, tmp_path):
    job = make_job("gcbc", steps=1, learning_rate=1e35, schedule="constant", weight_decay=0.0)
    with pytest.raises(
        UserError, match=r"gcbc seed 1: the validation loss is (nan|inf) after 1 steps; lower learning_rate"
    ):
        training.train(job, dataset, spec, torch.device("cpu"), tmp_path / "state")


def test_a_flipped_bit_in_a_saved_state_starts_the_training_again(dataset, spec, make_job, tmp_path, caplog):
    job, state = make_job("gcbc"), tmp_path / "state"
    begun = training.Training(job, dataset, spec, torch.device("cpu"), state)
    begun.step()
    begun.save()
    whole = state.read_bytes()
    for place in (-1, len(whole) // 2):
        damaged = bytearray(whole)
        damaged[place] ^= 1
        state.write_bytes(damaged)
        again = training.Training(job, dataset, spec, torch.device("cpu"), state)
        assert again.done == 0
        assert "is damaged; starting again" in caplog.text
    state.write_bytes(whole)
    assert training.Training(job, dataset, spec, torch.device("cpu"), state).done == 1
