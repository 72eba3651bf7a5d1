import dataclasses

import numpy as np
import pytest
import torch

from beso import envs, methods
from beso.config import build
from beso.core import checkpoint
from beso.core.noise import EpisodeNoise
from beso.core.seeding import generator
from beso.data import play
from beso.data.scaling import CLIP, Scaling
from beso.data.split import model_split
from beso.diffusion.score_policy import ScorePolicy
from beso.envs.protocol import TrialRequest
from beso.errors import UserError
from beso.evaluation import trials
from beso.evaluation.config import Chunk, EvaluationConfig, chunks
from beso.evaluation.rollout import EvaluationJob, evaluate
from beso.policy import BatchPolicy, Policy
from beso.training.loop import train

CPU = torch.device("cpu")
CONFIG = EvaluationConfig(seed=3, rollouts=5, goals=("training", "held_out"), chunk=2, max_actions=4)


class Recorder:
    """A policy that notes its context and answers with a constant."""

    def __init__(self, answer):
        self.answer, self.calls = answer, []

    def act(self, observations, actions, goal, noise, memory):
        self.calls.append((observations.clone(), actions.clone(), goal.clone()))
        return torch.full((len(observations), 2), self.answer)


@pytest.fixture
def scaling(dataset, spec):
    return Scaling.fit(dataset, np.arange(len(dataset)), spec)


@pytest.fixture
def make_agent(scaling):
    """make_agent(method, context, goals) -> an agent around a policy in these units."""
    return lambda method, context, goals: BatchPolicy(checkpoint.LoadedModel(method, scaling, context), goals, CPU)


def test_agent_grows_and_then_slides_its_context(scaling, make_agent):
    policy = Recorder(0.25)
    agent = make_agent(policy, 3, np.ones((2, 1, 16)))
    states = np.arange(5)[:, None, None] + np.zeros((5, 2, 16))
    for state in states:
        agent.act(state, noise=None)
    lengths = [(observations.shape[1], actions.shape[1]) for observations, actions, _ in policy.calls]
    assert lengths == [(1, 0), (2, 1), (3, 2), (3, 2), (3, 2)]
    observations, actions, goal = policy.calls[-1]
    expected = scaling.scale_observations(torch.from_numpy(states[2:5]).float()).transpose(0, 1)
    assert torch.equal(observations, expected)
    assert (actions == 0.25).all()
    assert (goal[..., list(scaling.goal_masked)] == 0).all()


def test_agent_clips_what_it_does_and_what_it_remembers(scaling, make_agent):
    policy = Recorder(9.0)
    agent = make_agent(policy, 3, np.ones((1, 1, 16)))
    action = agent.act(np.zeros((1, 16)), noise=None)
    agent.act(np.zeros((1, 16)), noise=None)
    assert policy.calls[1][1] == pytest.approx(CLIP)
    assert action == pytest.approx(scaling.raw_actions(torch.full((1, 2), CLIP)).numpy())


def test_agent_goes_on_with_the_running_episodes(make_agent):
    policy = Recorder(0.0)
    agent = make_agent(policy, 2, np.arange(3)[:, None, None] + np.zeros((3, 1, 16)))
    agent.act(np.arange(3)[:, None] + np.zeros((3, 16)), noise=None)
    agent.keep(np.array([True, False, True]))
    agent.act(np.zeros((2, 16)), noise=None)
    first, second = policy.calls
    assert torch.equal(second[0][:, 0], first[0][[0, 2], 0])
    assert torch.equal(second[2], first[2][[0, 2]])


def test_agent_keeps_the_memory_of_the_running_episodes(make_agent):
    class Counter:
        def act(self, observations, actions, goal, noise, memory):
            memory["steps"] = memory.get("steps", torch.arange(len(observations))) + 10
            return torch.zeros(len(observations), 2)

    agent = make_agent(Counter(), 1, np.zeros((3, 1, 16)))
    agent.act(np.zeros((3, 16)), noise=None)
    agent.keep(np.array([False, True, True]))
    agent.act(np.zeros((2, 16)), noise=None)
    assert agent.memory["steps"].tolist() == [21, 22]


def test_chunks_cover_every_episode_once():
    assert chunks(CONFIG) == [Chunk(g, a, b) for g in ("training", "held_out") for a, b in ((0, 2), (2, 4), (4, 5))]


def test_an_episodes_noise_is_its_own():
    streams = [np.random.default_rng(i) for i in range(3)]
    batch = EpisodeNoise(streams)
    batch.normal(1, 2)
    batch.keep(np.array([False, True, True]))
    alone = EpisodeNoise([np.random.default_rng(2)])
    alone.normal(1, 2)
    assert torch.equal(batch.normal(1, 2)[1], alone.normal(1, 2)[0])


@pytest.fixture
def job(make_dataset, make_job, small_models, spec, tmp_path):
    """The evaluation of a briefly trained C-BESO."""
    play.save(make_dataset([30, 32, 34, 36], seed=0), tmp_path / "data")
    dataset, training = play.load(tmp_path / "data", spec), make_job("c_beso")
    result = train(training, dataset, spec, CPU, tmp_path / "state")
    checkpoint.save(tmp_path / "models", training, spec.sizes, result, play.data_digest(dataset))
    sampling = build(methods.sampling("c_beso"), small_models["c_beso"][1], "sampling")
    request = TrialRequest("", training.seed, range(8), CONFIG.seed, tmp_path / "data", training.train_fraction, 0)
    made = {
        (goals, training.seed): envs.trial_maker("block_push")(request._replace(goals=goals)) for goals in CONFIG.goals
    }
    trials.save(made, tmp_path / "trials")
    folders = (tmp_path / "data", tmp_path / "trials", tmp_path / "models")
    return EvaluationJob("block_push", *folders, training.seed, sampling, CONFIG, "cpu")


def split(job, episodes):
    """Training and held-out episodes of a job's model."""
    trained = checkpoint.load_description(job.models, job.seed)["job"]
    return model_split(episodes, trained["train_fraction"], trained["root_seed"], job.seed)


def play_chunk(job, *chunk, film=None):
    (rows,) = evaluate(job, [Chunk(*chunk)], film)
    return rows


def test_rows_say_what_was_played(job, spec):
    rows = play_chunk(job, "held_out", 0, 2)
    assert [(row["seed"], row["goals"], row["episode"], row["length"]) for row in rows] == [
        (job.seed, "held_out", 0, 4),
        (job.seed, "held_out", 1, 4),
    ]
    dataset = play.load(job.data, spec)
    _, held_out = split(job, len(dataset))
    for row in rows:
        assert row["goal_demonstration"] in held_out
        assert row["goal_tasks"] == " ".join(map(str, dataset.completed(row["goal_demonstration"])))
        assert row["result"] in (0, 0.5, 1)
        assert row["goal_distance"] > 0


def test_chunks_of_one_call_are_those_of_several(job):
    together = evaluate(job, [Chunk("training", 0, 2), Chunk("held_out", 2, 3)])
    assert together == [play_chunk(job, "training", 0, 2), play_chunk(job, "held_out", 2, 3)]


def test_episodes_that_were_not_made_are_refused(job, tmp_path):
    with pytest.raises(UserError, match="episode 8 with goal set training and seed 1 was not made: there are 8"):
        play_chunk(job, "training", 7, 9)
    with pytest.raises(UserError, match=r"nowhere has no trials\.json: run `dvc repro trials`"):
        play_chunk(dataclasses.replace(job, trials=tmp_path / "nowhere"), "training", 0, 1)


def test_a_researchers_policy_acts_like_the_evaluations(job, small_models):
    """Policy.load and a loop on raw observations need the trained folder alone."""
    policy = Policy.load(job.models, seed=job.seed, sampling=small_models["c_beso"][1], device="cpu")
    with pytest.raises(UserError, match="no goal"):
        policy.act(np.zeros(16))
    policy.reset(np.zeros((1, 16)), seed=3)
    first = [policy.act(np.full(16, 0.1 * i)) for i in range(4)]
    policy.reset(np.zeros(16), seed=3)
    assert np.array_equal(first, [policy.act(np.full(16, 0.1 * i)) for i in range(4)])
    agent = BatchPolicy(checkpoint.load(job.models, job.seed, job.sampling, CPU), np.zeros((1, 1, 16)), CPU)
    noise = EpisodeNoise([generator(3, "policy noise")])
    assert np.array_equal(first, [agent.act(np.full((1, 16), 0.1 * i), noise)[0] for i in range(4)])
    with pytest.raises(UserError, match=r"sampling.nothing = 1: unknown key"):
        Policy.load(job.models, sampling={"nothing": 1})
    with pytest.raises(UserError, match="context_length = 9: must be at most the model's window, 3"):
        Policy.load(job.models, sampling={**small_models["c_beso"][1], "context_length": 9})


NAN = np.where(np.arange(16) == 3, np.nan, 0.0)


@pytest.mark.parametrize(
    ("observation", "message"),
    [
        (np.zeros(15), r"observation has shape \(15,\), expected \(16,\)"),
        (np.zeros((1, 16)), r"observation has shape \(1, 16\), expected \(16,\)"),
        (NAN, r"observation holds nan at \[3\]: every number must be finite"),
        (np.full(16, 1e300), r"observations holds inf at \[0, 0\]"),
        ({"observation": np.zeros(16)}, r"observation is a dict, expected an array of shape \(16,\)"),
        (["x"] * 16, "observation holds <U1, expected real numbers"),
    ],
)
def test_an_observation_that_is_no_state_is_refused(job, observation, message):
    policy = Policy.load(job.models, seed=job.seed, device="cpu")
    policy.reset(np.zeros(16))
    with pytest.raises(UserError, match=message) as caught:
        policy.act(observation)
    assert "\n" not in str(caught.value)
    assert policy.act(np.zeros(16)).shape == (2,)


@pytest.mark.parametrize(
    ("goal", "seed", "message"),
    [
        (np.zeros(17), 0, r"goal has shape \(17,\), expected \(1, 16\) or \(16,\)"),
        (np.zeros((2, 16)), 0, r"goal has shape \(2, 16\), expected"),
        (NAN, 0, r"goal holds nan at \[3\]"),
        (np.zeros(16), -1, "seed = -1: must be a whole number of at least 0"),
        (np.zeros(16), 0.5, "seed = 0.5: must be a whole number of at least 0"),
    ],
)
def test_a_goal_or_seed_that_is_none_is_refused(job, goal, seed, message):
    policy = Policy.load(job.models, seed=job.seed, device="cpu")
    with pytest.raises(UserError, match=message):
        policy.reset(goal, seed)


def test_a_policy_that_computes_no_number_says_so(job, monkeypatch):
    policy = Policy.load(job.models, seed=job.seed, device="cpu")
    policy.reset(np.zeros(16))
    monkeypatch.setattr(ScorePolicy, "act", lambda self, observations, *_: observations[:, -1, :2] * np.nan)
    with pytest.raises(UserError, match=r"the policy's actions holds nan at \[0, 0\]"):
        policy.act(np.zeros(16))


def test_a_model_of_other_data_is_not_evaluated(job):
    path = checkpoint.paths(job.models, job.seed)[1]
    path.write_text(path.read_text().replace('"data": "', '"data": "0'))
    with pytest.raises(UserError, match="was trained on other play data than"):
        play_chunk(job, "training", 0, 1)


@pytest.fixture
def starts(monkeypatch):
    """First observations of all episodes from now on."""
    from beso.envs.block_push.simulator import BlockPushEnv

    starts, original = [], BlockPushEnv.reset

    def reset(self, **keywords):
        observation, info = original(self, **keywords)
        starts.append(observation)
        return observation, info

    monkeypatch.setattr(BlockPushEnv, "reset", reset)
    return starts


def test_a_policy_gets_the_goals_of_its_episodes(job, spec, starts, monkeypatch):
    """The demonstration's last state, its blocks exchanged where the targets lie the other way round."""
    from beso.envs.block_push.simulator.environment import fitting_goal

    given, act = [], BatchPolicy.act

    def noted_act(self, observations, noise):
        given.append(self.goal)
        return act(self, observations, noise)

    monkeypatch.setattr(BatchPolicy, "act", noted_act)
    rows = play_chunk(job, "training", 0, 8)
    dataset = play.load(job.data, spec)
    scaling = Scaling.fit(dataset, split(job, len(dataset))[0], spec)
    last = [dataset.observations[dataset.episode_ends[row["goal_demonstration"]] - 1][None] for row in rows]
    expected = np.stack([fitting_goal(state, start) for state, start in zip(last, starts, strict=True)])
    assert any(not np.array_equal(goal, state) for goal, state in zip(expected, last, strict=True))
    assert torch.equal(given[0], scaling.scale_goals(torch.from_numpy(expected.astype(np.float32))))
    assert torch.equal(given[-1], given[0])


@pytest.mark.parametrize(("context_length", "longest"), [(None, 3), (2, 2), (1, 1)])
def test_a_context_may_be_shorter_than_the_training_window(job, monkeypatch, context_length, longest):
    lengths, act = [], BatchPolicy.act

    def noted_act(self, observations, noise):
        action = act(self, observations, noise)
        lengths.append((self.observations.shape[1], self.actions.shape[1]))
        return action

    monkeypatch.setattr(BatchPolicy, "act", noted_act)
    shorter = dataclasses.replace(job.sampling, context_length=context_length)
    play_chunk(dataclasses.replace(job, sampling=shorter), "training", 0, 1)
    assert max(lengths) == (longest, longest - 1)


def test_the_same_chunk_gives_the_same_rows_filmed_or_not(job):
    plain = play_chunk(job, "training", 0, 2)
    play_chunk(job, "training", 2, 4)  # other episodes in between
    pictures = []
    filmed = play_chunk(job, "training", 0, 2, film=pictures.append)
    assert filmed == plain
    assert len(pictures) == plain[0]["length"] + 1
    assert pictures[0].shape == (240, 320, 3)


def test_every_method_meets_the_same_starts(job, starts):
    """The start is drawn from evaluation seed, goal set, model seed and episode alone, not from the chunk either."""
    evaluate(job, [Chunk("training", 0, 2), Chunk("training", 1, 2), Chunk("held_out", 1, 2)])
    assert np.array_equal(starts[1], starts[2])
    assert not np.array_equal(starts[1], starts[3])
