import itertools

import pytest
import torch

from beso.core.noise import BatchNoise
from beso.methods import c_ibc
from tests.beso.methods import SIZES, batch

CONFIG = c_ibc.Config(width=16, layers=2, counter_examples=6, energy_penalty=0.0, gradient_penalty=0.0)
SEARCH = c_ibc.Sampling(candidates=256, iterations=3, noise_scale=0.3, noise_shrink=0.5)


def make(sampling=SEARCH, **changes):
    config = c_ibc.Config(**{**vars(CONFIG), **changes})
    return c_ibc.Method(config, sampling, SIZES, torch.Generator().manual_seed(0))


def test_info_nce_is_the_cross_entropy_of_picking_the_demonstrated_action():
    energy = torch.tensor([[0.2, -1.0, 3.0], [1.5, 0.1, 0.0]], dtype=torch.float64)
    expected = 0.0
    for row in energy.tolist():
        weights = [2.718281828459045**-e for e in row]
        expected -= torch.tensor(weights[0] / sum(weights)).log().item() / 2
    assert c_ibc.info_nce(energy).item() == pytest.approx(expected, abs=1e-6)


def test_penalties_are_added_as_weighted_means():
    data = batch(5, 1)

    def loss(**changes):
        return make(**changes).loss(data, torch.Generator().manual_seed(3)).item()

    plain = make()
    draws = torch.rand(5, 6, 2, generator=torch.Generator().manual_seed(3))
    actions = torch.cat([data.actions, 2.2 * draws - 1.1], dim=1).requires_grad_()
    energy = plain.energy(data.observations[:, -1], data.goal, actions)
    energy.sum().backward()
    assert loss() == pytest.approx(c_ibc.info_nce(energy).item(), abs=1e-6)
    assert loss(energy_penalty=0.5) - loss() == pytest.approx(0.5 * energy.square().mean().item(), abs=1e-6)
    excess = (actions.grad.abs().amax(dim=-1) - 1).clamp(min=0).square().mean().item()
    assert loss(gradient_penalty=2.0) - loss() == pytest.approx(2 * excess, abs=1e-6)


def test_the_gradient_penalty_flattens_steep_energies():
    method, data = make(gradient_penalty=1.0), batch(8, 1)
    with torch.no_grad():
        method.network.output.weight.mul_(100)
    before = method.loss(data, torch.Generator().manual_seed(0))
    before.backward()
    assert (method.network.hidden[0].weight.grad != 0).any()
    with torch.no_grad():
        for parameter in method.parameters():
            parameter -= 1e-6 * parameter.grad
    assert method.loss(data, torch.Generator().manual_seed(0)) < before


def test_the_search_finds_the_lowest_energy():
    method = make()
    target = torch.tensor([0.4, -0.7])
    method.energy = lambda observation, goal, actions: 200 * (actions - target).square().sum(dim=-1)
    observations, actions, goal, *_ = batch(20, 1)
    found = method.act(observations, actions[:, :0], goal, BatchNoise(20, torch.Generator().manual_seed(0)), {})
    assert (found - target).norm(dim=1).max() < 0.1


def test_perturbations_shrink_every_round():
    method, rounds = make(c_ibc.Sampling(500, 3, 0.02, 0.5)), []

    def energy(observation, goal, actions):
        rounds.append(actions)
        return 1e6 * (actions - rounds[0][:, :1]).square().sum(dim=-1)  # all but the first candidate are ruled out

    method.energy = energy
    observations, actions, goal, *_ = batch(1, 1)
    method.act(observations, actions[:, :0], goal, BatchNoise(1, torch.Generator().manual_seed(0)), {})
    assert len(rounds) == 4
    assert rounds[1].std(dim=1).mean().item() == pytest.approx(0.02, rel=0.15)
    for first, second in itertools.pairwise(rounds[1:]):
        assert second.std(dim=1).mean() < 0.75 * first.std(dim=1).mean()


def test_actions_stay_in_the_box():
    method = make(c_ibc.Sampling(64, 3, 5.0, 1.0))
    method.energy = lambda observation, goal, actions: -actions.sum(dim=-1)
    observations, actions, goal, *_ = batch(4, 1)
    found = method.act(observations, actions[:, :0], goal, BatchNoise(4, torch.Generator().manual_seed(0)), {})
    assert found == pytest.approx(1.1)


@pytest.mark.parametrize("changes", [{"candidates": 0}, {"iterations": -1}, {"noise_scale": 0}, {"noise_shrink": 2}])
def test_an_impossible_search_is_refused(changes):
    with pytest.raises(ValueError, match="must"):
        c_ibc.Sampling(**{**vars(SEARCH), **changes})
