import dataclasses

import numpy as np
import pytest
import torch

from beso import checkpoint, methods
from beso.config import build
from beso.data import play
from beso.data.scaling import CLIP, Scaling
from beso.evaluation_config import Chunk, EvaluationConfig, chunks
from beso.noise import EpisodeNoise
from beso.rollout import Agent, evaluate_chunk
from beso.training import split, train

CPU = torch.device("cpu")
CONFIG = EvaluationConfig(seed=3, rollouts=5, goals=("training", "held_out"), chunk=2, max_actions=4, video=False)


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


def test_agent_grows_and_then_slides_its_context(scaling):
    policy = Recorder(0.25)
    agent = Agent(policy, 3, scaling, np.ones((2, 1, 16)), CPU)
    states = np.arange(5)[:, None, None] + np.zeros((5, 2, 16))
    for state in states:
        agent.act(state, noise=None)
    lengths = [(observations.shape[1], actions.shape[1]) for observations, actions, _ in policy.calls]
    assert lengths == [(1, 0), (2, 1), (3, 2), (3, 2), (3, 2)]
    observations, actions, goal = policy.calls[-1]
    expected = scaling.observations(torch.from_numpy(states[2:5]).float()).transpose(0, 1)
    assert torch.equal(observations, expected)
    assert (actions == 0.25).all()
    assert (goal[..., list(scaling.goal_masked)] == 0).all()


def test_agent_clips_what_it_does_and_what_it_remembers(scaling):
    policy = Recorder(9.0)
    agent = Agent(policy, 3, scaling, np.ones((1, 1, 16)), CPU)
    action = agent.act(np.zeros((1, 16)), noise=None)
    agent.act(np.zeros((1, 16)), noise=None)
    assert policy.calls[1][1] == pytest.approx(CLIP)
    assert action == pytest.approx(scaling.raw_actions(torch.full((1, 2), CLIP)).numpy())


def test_agent_goes_on_with_the_running_episodes(scaling):
    policy = Recorder(0.0)
    agent = Agent(policy, 2, scaling, np.arange(3)[:, None, None] + np.zeros((3, 1, 16)), CPU)
    agent.act(np.arange(3)[:, None] + np.zeros((3, 16)), noise=None)
    agent.keep(np.array([True, False, True]))
    agent.act(np.zeros((2, 16)), noise=None)
    first, second = policy.calls
    assert torch.equal(second[0][:, 0], first[0][[0, 2], 0])
    assert torch.equal(second[2], first[2][[0, 2]])


def test_agent_keeps_the_memory_of_the_running_episodes(scaling):
    class Counter:
        def act(self, observations, actions, goal, noise, memory):
            memory["steps"] = memory.get("steps", torch.arange(len(observations))) + 10
            return torch.zeros(len(observations), 2)

    agent = Agent(Counter(), 1, scaling, np.zeros((3, 1, 16)), CPU)
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
def trained(make_dataset, make_job, spec, tmp_path):
    """A briefly trained C-BESO and its data on disk: arguments of evaluate_chunk up to the sampling."""
    play.save(make_dataset([30, 32, 34, 36], seed=0), tmp_path / "data")
    dataset, job = play.load(tmp_path / "data", spec), make_job("c_beso")
    result = train(job, dataset, spec, CPU, tmp_path / "state")
    checkpoint.save(tmp_path / "models", job, result, play.data_digest(dataset))
    return "block_push", tmp_path / "data", tmp_path / "models", job


@pytest.fixture
def sampling(small_models):
    return build(methods.load("c_beso").Sampling, small_models["c_beso"][1], "sampling")


def test_rows_say_what_was_played(trained, sampling, spec):
    rows = evaluate_chunk(*trained, sampling, CONFIG, Chunk("held_out", 0, 2), "cpu")
    assert [(row["seed"], row["goals"], row["episode"], row["length"]) for row in rows] == [
        (trained[3].seed, "held_out", 0, 4),
        (trained[3].seed, "held_out", 1, 4),
    ]
    dataset = play.load(trained[1], spec)
    _, held_out = split(trained[3], len(dataset))
    for row in rows:
        assert row["goal_demonstration"] in held_out
        assert row["goal_tasks"] == " ".join(map(str, dataset.completed(row["goal_demonstration"])))
        assert row["result"] in (0, 0.5, 1)
        assert row["goal_distance"] > 0


@pytest.fixture
def starts(monkeypatch):
    """First observations of all episodes from now on."""
    from beso.envs.block_push import BlockPushEnv

    starts, original = [], BlockPushEnv.reset

    def reset(self, **keywords):
        observation, info = original(self, **keywords)
        starts.append(observation)
        return observation, info

    monkeypatch.setattr(BlockPushEnv, "reset", reset)
    return starts


def test_a_policy_gets_the_goals_of_its_episodes(trained, sampling, spec, starts, monkeypatch):
    """The demonstration's last state, its blocks exchanged where the targets lie the other way round."""
    from beso.envs.block_push import evaluation_goal

    given, act = [], Agent.act

    def noted_act(self, observations, noise):
        given.append(self.goal)
        return act(self, observations, noise)

    monkeypatch.setattr(Agent, "act", noted_act)
    rows = evaluate_chunk(*trained, sampling, CONFIG, Chunk("training", 0, 8), "cpu")
    dataset = play.load(trained[1], spec)
    scaling = Scaling.fit(dataset, split(trained[3], len(dataset))[0], spec)
    last = [dataset.observations[dataset.episode_ends[row["goal_demonstration"]] - 1][None] for row in rows]
    expected = np.stack([evaluation_goal(state, start) for state, start in zip(last, starts, strict=True)])
    assert any(not np.array_equal(goal, state) for goal, state in zip(expected, last, strict=True))
    assert torch.equal(given[0], scaling.goals(torch.from_numpy(expected.astype(np.float32))))
    assert torch.equal(given[-1], given[0])


@pytest.mark.parametrize(("context_length", "longest"), [(None, 3), (2, 2), (1, 1)])
def test_a_context_may_be_shorter_than_the_training_window(trained, sampling, monkeypatch, context_length, longest):
    lengths, act = [], Agent.act

    def noted_act(self, observations, noise):
        action = act(self, observations, noise)
        lengths.append((self.observations.shape[1], self.actions.shape[1]))
        return action

    monkeypatch.setattr(Agent, "act", noted_act)
    shorter = dataclasses.replace(sampling, context_length=context_length)
    evaluate_chunk(*trained, shorter, CONFIG, Chunk("training", 0, 1), "cpu")
    assert max(lengths) == (longest, longest - 1)


def test_the_same_chunk_gives_the_same_rows_filmed_or_not(trained, sampling):
    plain = evaluate_chunk(*trained, sampling, CONFIG, Chunk("training", 0, 2), "cpu")
    evaluate_chunk(*trained, sampling, CONFIG, Chunk("training", 2, 4), "cpu")  # other episodes in between
    pictures = []
    filmed = evaluate_chunk(*trained, sampling, CONFIG, Chunk("training", 0, 2), "cpu", pictures.append)
    assert filmed == plain
    assert len(pictures) == plain[0]["length"] + 1
    assert pictures[0].shape == (240, 320, 3)


def test_every_method_meets_the_same_starts(trained, sampling, starts):
    """The start is drawn from evaluation seed, goal set, model seed and episode alone, not from the chunk either."""
    evaluate_chunk(*trained, sampling, CONFIG, Chunk("training", 0, 2), "cpu")
    evaluate_chunk(*trained, sampling, CONFIG, Chunk("training", 1, 2), "cpu")
    evaluate_chunk(*trained, sampling, CONFIG, Chunk("held_out", 1, 2), "cpu")
    assert np.array_equal(starts[1], starts[2])
    assert not np.array_equal(starts[1], starts[3])
