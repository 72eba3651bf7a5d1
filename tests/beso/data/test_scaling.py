import json

import numpy as np
import pytest
import torch

from beso.config import build
from beso.data.play import Episode, assemble
from beso.data.scaling import Scaling

TRAINING = np.array([0, 2, 5])


@pytest.fixture
def scaling(dataset, spec):
    return Scaling.fit(dataset, TRAINING, spec)


@pytest.fixture
def training_rows(dataset):
    return np.concatenate([np.arange(dataset.episode_starts[e], dataset.episode_ends[e]) for e in TRAINING])


def test_training_observations_get_mean_zero_and_standard_deviation_one(scaling, dataset, training_rows, spec):
    scaled = scaling.scale_observations(torch.from_numpy(dataset.observations[training_rows]).double())
    assert scaled.shape[1] == len(spec.visible) < spec.observation_size
    assert torch.allclose(scaled.mean(dim=0), torch.zeros(10, dtype=torch.float64), atol=1e-12)
    assert torch.allclose(scaled.std(dim=0, correction=0), torch.ones(10, dtype=torch.float64), atol=1e-12)


def test_training_actions_fill_the_range_from_minus_one_to_one(scaling, dataset, training_rows):
    scaled = scaling.scale_actions(torch.from_numpy(dataset.actions[training_rows]))
    assert torch.allclose(scaled.amin(dim=0), torch.tensor(-1.0), atol=1e-6)
    assert torch.allclose(scaled.amax(dim=0), torch.tensor(1.0), atol=1e-6)


def test_statistics_ignore_the_other_episodes(scaling, dataset, training_rows, spec):
    others = np.setdiff1d(np.arange(len(dataset.observations)), training_rows)
    dataset.observations[others] += 100
    dataset.actions[others] *= 50
    assert Scaling.fit(dataset, TRAINING, spec) == scaling
    assert Scaling.fit(dataset, np.array([0, 1, 2]), spec) != scaling


def test_statistics_do_not_depend_on_the_order_of_the_episodes(scaling, dataset, spec):
    assert Scaling.fit(dataset, TRAINING[::-1], spec) == scaling


def test_actions_survive_a_round_trip(scaling, dataset):
    raw = torch.from_numpy(dataset.actions)
    # Six float32 operations on numbers of the size of the range (0.06).
    assert torch.allclose(scaling.raw_actions(scaling.scale_actions(raw)), raw, atol=1e-7)
    beyond = torch.tensor([[1.1, -1.1]])
    assert torch.allclose(scaling.scale_actions(scaling.raw_actions(beyond)), beyond, atol=1e-6)


def test_goals_are_scaled_states_with_the_masked_dimensions_at_zero(scaling, dataset, spec):
    raw = torch.from_numpy(dataset.observations[:6]).view(2, 3, 16)
    goals, states = scaling.scale_goals(raw), scaling.scale_observations(raw)
    masked = list(spec.goal_masked)
    kept = [i for i in range(len(spec.visible)) if i not in masked]
    assert kept == [0, 1, 3, 4], "only the places of the two blocks are told"
    assert (goals[..., masked] == 0).all()
    assert torch.equal(goals[..., kept], states[..., kept])


def test_dimensions_that_never_change_stay_finite(spec):
    episode = Episode(np.full((5, 16), 0.7), np.full((5, 2), 0.02), np.zeros((5, 4)))
    constant = assemble([episode, episode], spec, {})
    scaling = Scaling.fit(constant, np.array([0]), spec)
    assert torch.allclose(
        scaling.scale_observations(torch.from_numpy(constant.observations)), torch.zeros(10), atol=1e-6
    )
    actions = torch.from_numpy(constant.actions)
    assert torch.allclose(scaling.raw_actions(scaling.scale_actions(actions)), actions, atol=1e-6)


def test_survives_json_exactly(scaling):
    assert build(Scaling, json.loads(json.dumps(scaling.as_dict())), "scaling") == scaling
