from dataclasses import replace

import numpy as np
import pytest
import torch

from beso.data.play import Episode, assemble
from beso.data.scaling import Scaling
from beso.envs import spec
from beso.errors import UserError
from pipeline.tools.goal_use import errors

SPEC = spec("block_push")


@pytest.fixture
def dataset():
    """Episodes whose actions say where the first block will end: on the left, or every second time on the right."""
    draws, episodes = np.random.default_rng(0), []
    for i in range(10):
        observations = draws.standard_normal((50, 16)).astype(np.float32)
        side = 1.0 if i % 2 else -1.0
        observations[-1, 0] = side
        actions = np.column_stack([np.full(50, side), draws.uniform(-1, 1, 50)])
        tasks = np.zeros((50, 4), dtype=np.uint8)
        episodes.append(Episode(observations, actions.astype(np.float32), tasks))
    return assemble(episodes, SPEC, {"source": "test"})


class Policy:
    """Acts towards its goal, or always to the left."""

    def __init__(self, looks):
        self.looks = looks

    def act(self, observations, actions, goal, noise, memory):
        assert observations.shape[1] == actions.shape[1] + 1 == 3
        side = goal[:, -1, 0].sign() if self.looks else -torch.ones(len(goal))
        return torch.stack([side, 0.01 * noise.normal(1)[:, 0]], dim=1)


def test_only_a_policy_that_looks_at_its_goal_errs_with_anothers(dataset):
    scaling = Scaling.fit(dataset, np.arange(10), SPEC)

    def measured(looks):
        return errors(Policy(looks), scaling, dataset, np.arange(10), 1, 3, torch.Generator().manual_seed(0))

    own, other = measured(looks=True)
    assert other - own == pytest.approx(2.0, abs=0.01)  # 2 wrong in one of two entries
    own, other = measured(looks=False)
    assert own == other


def test_a_near_goal_is_the_state_so_many_steps_after_the_decision(dataset):
    dataset.observations[:, 0] = np.tile(np.arange(50), 10)  # a state's step, the same in every episode
    scaling = Scaling.fit(dataset, np.arange(10), SPEC)
    seen = []

    class Recording(Policy):
        def act(self, observations, actions, goal, noise, memory):
            steps = torch.stack([observations[:, -1, 0], goal[:, 0, 0]], dim=1) * scaling.std[0] + scaling.mean[0]
            seen.append(steps.round())
            return super().act(observations, actions, goal, noise, memory)

    errors(Recording(True), scaling, dataset, np.arange(10), 1, 3, torch.Generator().manual_seed(0), ahead=7)
    for steps in seen:
        assert steps[:, 0].tolist() == list(range(2, 40)) * 10
        assert (steps[:, 1] - steps[:, 0] == 7).all()
    with pytest.raises(UserError, match="has 50 steps, at least 52 are needed"):
        errors(Policy(True), scaling, dataset, np.arange(10), 1, 3, torch.Generator().manual_seed(0), ahead=12)


def test_an_episode_that_is_too_short_is_refused(dataset):
    scaling = Scaling.fit(dataset, np.arange(10), SPEC)
    short = replace(dataset, episode_ends=dataset.episode_ends - 20)  # the first has 30 steps
    with pytest.raises(UserError, match="has 30 steps, at least 40 are needed"):
        errors(Policy(True), scaling, short, np.arange(10), 1, 3, torch.Generator().manual_seed(0))
