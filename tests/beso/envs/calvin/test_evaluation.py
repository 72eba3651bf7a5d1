"""What counts as success, near misses, and a whole evaluation on pictures."""

import dataclasses

import numpy as np
import pytest
import torch

from beso import methods
from beso.config import build
from beso.core import checkpoint
from beso.data import play
from beso.encoders import encoder as images
from beso.encoders.resnet import ResNet18
from beso.envs.calvin import evaluation, trials
from beso.envs.calvin.simulator.observations import DRAWER, FIXTURES, LED, SLIDE
from beso.envs.calvin.spec import SPEC
from beso.envs.protocol import Outcome, Trial, TrialRequest
from beso.errors import UserError
from beso.evaluation import trials as stored
from beso.evaluation.config import Chunk, EvaluationConfig, chunks
from beso.evaluation.rollout import EvaluationJob, evaluate
from beso.policy import Policy
from beso.training.loop import train
from pipeline.machine import Machine
from pipeline.pool import map_jobs

IDLE = np.array([0, 0, 0, 0, 0, 0, 1.0])
CPU = torch.device("cpu")
TASKS = ("open_drawer", "turn_on_led")


@pytest.fixture(scope="module")
def environment():
    environment = evaluation.make()
    yield environment
    environment.close()


@pytest.fixture
def start(environment, scene):
    """start(*wanted tasks) -> a function that puts fixtures somewhere and takes a step that moves nothing."""

    def begin(*wanted):
        goal = np.zeros((1, 24, 24, 3), dtype=np.uint8)
        options = {"scene_obs": scene, "goal": goal, "tasks": np.isin(SPEC.tasks, wanted)}
        observation, info = environment.reset(seed=0, options=options)
        assert observation.shape == goal.shape[1:]
        assert info["goal"] is goal
        return put

    def put(**fixtures):
        values = scene[FIXTURES].copy()
        for name, value in fixtures.items():
            values[{"slide": SLIDE, "drawer": DRAWER, "led": LED}[name]] = value
        environment.table.fixtures.reset(values)
        _, reward, terminated, truncated, info = environment.step(IDLE)
        assert terminated == (reward == 1.0)
        assert not truncated
        return reward, [SPEC.tasks[task] for task in info["tasks"]]

    return begin


def test_a_task_must_be_done_whole(start):
    put = start("open_drawer")
    assert put(drawer=0.11) == (0, [])
    assert put(drawer=0.13) == (1, ["open_drawer"])


def test_other_tasks_do_not_count(start):
    put = start("open_drawer")
    assert put(slide=0.28, led=1) == (0, [])


def test_two_tasks_must_be_done_at_the_same_time(start):
    put = start("open_drawer", "turn_on_led")
    assert put(led=1, slide=0.28) == (0, ["turn_on_led"])
    assert put(drawer=0.2) == (0, ["turn_on_led", "open_drawer"]), "the light is off again"
    assert put(drawer=0.2, led=1) == (1, ["turn_on_led", "open_drawer"])


def test_nothing_is_forgotten_but_at_a_reset(start):
    start("turn_on_led")(led=1)
    assert start("turn_on_led", "open_drawer")() == (0, [])


def test_without_wanted_tasks_an_episode_goes_on(environment, scene):
    environment.reset(options={"scene_obs": scene})
    assert environment.step(IDLE)[1:4] == (0.0, False, False)


@pytest.mark.parametrize(
    ("done", "reward", "expected"),
    [
        ((), 0.0, ("", 0, 0)),
        ((31,), 0.0, ("31", 0, 1)),
        ((31, 14), 0.0, ("31 14", 0, 2)),
        ((14, 31), 1.0, ("14 31", 1, 2)),
    ],
)
def test_rows_count_the_wanted_tasks(done, reward, expected):
    trial = Trial(seed=0, options={}, tasks=(14, 31), limit=300, labels={})
    outcome = Outcome(reward, 120, np.zeros((2, 2, 3)), {"tasks": done}, np.zeros((1, 2, 2, 3)), np.zeros((2, 2, 3)))
    assert evaluation.score(trial, outcome) == dict(
        zip(("tasks", "success", "completed", "length"), (*expected, 120), strict=True)
    )


@pytest.fixture
def spec():
    return SPEC


@pytest.mark.parametrize("name", ["c_beso", "gcbc", "lmp", "c_bet"])
def test_a_policy_that_was_trained_with_its_encoder_sees_frames(name, make_dataset, make_job, small_models, tmp_path):
    states, data = make_dataset([30, 32, 34]), tmp_path / "data"
    frames = np.random.default_rng(0).integers(256, size=(96, 32, 32, 3), dtype=np.uint8)
    meta = {"source": "random frames", "finetune": {"frame_size": 32, "encoder": "0" * 64}}
    play.save(dataclasses.replace(states, observations=frames, meta=meta), data)
    encoding = images.Encoding(width=8, size=32, mean=(0.5,) * 3, std=(0.3,) * 3, precision="fp32")
    images.save(data, ResNet18(8, torch.Generator().manual_seed(0)), encoding, {}, shift=1)
    dataset, training = play.load(data, SPEC), make_job(name, steps=2)
    result = train(training, dataset, SPEC, CPU, tmp_path / "state", encoder=data)
    checkpoint.save(tmp_path / "models", training, SPEC.sizes, result, play.data_digest(dataset))
    assert sorted(path.name for path in (tmp_path / "models").iterdir()) == ["seed1.json", "seed1.safetensors"]

    (data / images.WEIGHTS).unlink()  # the model's own encoder is asked, not the one that it started from
    goal = frames[:1]
    request = TrialRequest("single_tasks", training.seed, range(3), 3, data, 0.7, 0, TASKS)
    stored.save({("single_tasks", training.seed): trials.make(request)}, tmp_path / "trials")
    config = EvaluationConfig(seed=3, rollouts=3, goals=("single_tasks",), chunk=2, max_actions=4)
    sampling = build(methods.sampling(name), small_models[name][1], "sampling")
    folders = (data, tmp_path / "trials", tmp_path / "models")
    job = EvaluationJob("calvin", *folders, training.seed, sampling, config, "cpu")
    played = {workers: play_workers(job, workers) for workers in (1, 2)}
    assert played[1] == played[2]
    assert [row["length"] for row in played[1]] == [4, 4, 4]

    # In a batch or alone, a frame has the same features; the policy is loaded without data.
    loaded = checkpoint.load(tmp_path / "models", 1, sampling, CPU)
    assert np.array_equal(loaded.encode(frames[:20])[7], loaded.encode(frames[7:8])[0])
    policy = Policy.load(tmp_path / "models", 1, device="cpu")
    policy.reset(goal)
    action = policy.act(frames[5])
    assert action.shape == (7,)
    policy.reset(goal)
    assert np.array_equal(policy.act(frames[5]), action)
    with pytest.raises(UserError, match=r"observation has shape \(31, 32, 3\), expected \(32, 32, 3\)"):
        policy.act(frames[5][:31])


def play_workers(job, workers):
    """The rows of a job, played by so many workers."""
    planned = chunks(job.config)
    shares = [planned[k::workers] for k in range(workers)]
    parts = list(map_jobs(evaluate, [(job, share) for share in shares], Machine(workers=workers)))
    return sorted((row for part in parts for rows in part for row in rows), key=lambda row: row["episode"])


def test_a_policy_is_evaluated_on_pictures(environment, make_dataset, make_job, small_models, tmp_path):
    play.save(make_dataset([30, 32, 34]), tmp_path / "data")
    encoding = images.Encoding(width=8, size=32, mean=(0.5,) * 3, std=(0.3,) * 3, precision="fp32")
    images.save(tmp_path / "data", ResNet18(8, torch.Generator().manual_seed(0)), encoding, {})
    dataset, training = play.load(tmp_path / "data", SPEC), make_job("gcbc")
    result = train(training, dataset, SPEC, CPU, tmp_path / "state")
    checkpoint.save(tmp_path / "models", training, SPEC.sizes, result, play.data_digest(dataset))
    request = TrialRequest("single_tasks", training.seed, range(2), 3, tmp_path / "data", 0.7, 0, TASKS)
    stored.save({("single_tasks", training.seed): trials.make(request)}, tmp_path / "trials")
    config = EvaluationConfig(seed=3, rollouts=2, goals=("single_tasks",), chunk=2, max_actions=4)
    sampling = build(methods.sampling("gcbc"), small_models["gcbc"][1], "sampling")
    folders = (tmp_path / "data", tmp_path / "trials", tmp_path / "models")
    job = EvaluationJob("calvin", *folders, training.seed, sampling, config, "cpu")
    (rows,) = evaluate(job, [Chunk("single_tasks", 0, 2)])
    assert [list(row.values()) for row in rows] == [
        [training.seed, "single_tasks", i, str(SPEC.tasks.index(TASKS[i])), "", 0, 0, 4] for i in range(2)
    ]
    seen = []
    assert evaluate(job, [Chunk("single_tasks", 1, 2)], witness=lambda *what: seen.append(what)) == [rows[1:]]
    ((row, outcome),) = seen
    trial = stored.load(tmp_path / "trials")["single_tasks", training.seed][1]
    assert row == rows[1]
    assert np.array_equal(outcome.goal, trial.options["goal"])
    environment.reset(seed=trial.seed, options=trial.options)
    assert np.array_equal(outcome.start, environment.table.picture(32))
    assert outcome.observation.shape == outcome.start.shape
    assert not np.array_equal(outcome.observation, outcome.start)
