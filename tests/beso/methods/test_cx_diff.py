import math

import pytest
import torch

from beso.core.noise import BatchNoise
from beso.methods import cx_diff
from beso.networks.transformer import TransformerConfig
from tests.beso.methods import SIZES, batch

TRANSFORMER = TransformerConfig(16, 1, 2, 3, 0.0, 0.0, "sequential")


def make(steps=None, extra_steps=0, length=10, beta_max=0.5):
    config = cx_diff.Config(TRANSFORMER, length, 1e-4, beta_max, final_goals=0.0)
    return cx_diff.Method(
        config, cx_diff.Sampling(steps, extra_steps, None), SIZES, torch.Generator().manual_seed(0)
    ).eval()


def test_the_full_chain_is_ho_et_als():
    betas = torch.linspace(1e-4, 0.5, 10, dtype=torch.float64)
    shares = cx_diff.signal_shares(10, 1e-4, 0.5)
    updates = cx_diff.ancestral_updates(shares.tolist(), 10)
    assert [t for t, *_ in updates] == list(range(10, 0, -1))
    for t, shrink, scale, slope, std in updates:
        beta, share = betas[t - 1].item(), torch.prod(1 - betas[:t]).item()
        assert shrink == pytest.approx(math.sqrt(share))
        assert scale == pytest.approx(1 / math.sqrt(1 - beta))
        assert slope == pytest.approx(beta / math.sqrt(1 - share))
        before = torch.prod(1 - betas[: t - 1]).item()
        assert std == pytest.approx(math.sqrt(beta * (1 - before) / (1 - share)))


@pytest.mark.parametrize(("steps", "levels"), [(3, [10, 7, 3]), (1, [10]), (4, [10, 8, 5, 2])])
def test_fewer_steps_are_evenly_chosen(steps, levels):
    updates = cx_diff.ancestral_updates(cx_diff.signal_shares(10, 1e-4, 0.5).tolist(), steps)
    assert [t for t, *_ in updates] == levels
    assert updates[-1][-1] == 0


@pytest.mark.parametrize(("steps", "extra"), [(None, 0), (None, 8), (3, 0), (3, 2)])
def test_network_calls_are_the_steps_and_the_extra_steps(steps, extra):
    method, levels = make(steps, extra), []

    def network(actions, level, observations, goal, last_only):
        levels.append(level[0].item())
        return torch.zeros_like(actions[:, -1:])

    method.network.forward = network
    observations, actions, goal, *_ = batch(2, 3)
    method.act(observations, actions[:, :-1], goal, BatchNoise(2, torch.Generator().manual_seed(0)), {})
    assert len(levels) == (steps or 10) + extra
    assert levels[len(levels) - extra :] == pytest.approx([0.1] * extra), "extra steps are at the lowest level"


def test_previous_actions_are_shrunk_as_in_training_but_not_noised():
    method, seen = make(), []

    def network(actions, level, observations, goal, last_only):
        seen.append(actions[:, :-1].clone())
        return torch.zeros_like(actions[:, -1:])

    method.network.forward = network
    observations, actions, goal, *_ = batch(2, 3)
    method.act(observations, actions[:, :-1], goal, BatchNoise(2, torch.Generator().manual_seed(0)), {})
    for previous, share in zip(seen, method.alpha_bar.flip(0), strict=False):
        assert torch.allclose(previous, share.sqrt() * actions[:, :-1])


@pytest.mark.parametrize("steps", [None, 3])
def test_with_the_exact_noise_of_a_gaussian_the_chain_draws_from_it(steps):
    """Data N(0.3, 0.2^2): E[eps | a, t] is known in closed form."""
    mean, std = 0.3, 0.2
    method = make(steps, length=200 if steps is None else 10, beta_max=0.05 if steps is None else 0.5)
    shares = method.alpha_bar

    def exact(actions, level, observations, goal, last_only):
        share = shares[(level[0] * method.length).round().long()]
        a = actions[:, -1:]
        return (1 - share).sqrt() * (a - share.sqrt() * mean) / (share * std**2 + 1 - share)

    method.network.forward = exact
    count = 20_000
    observations, actions, goal, *_ = batch(1, 1)
    observations, goal = observations.expand(count, -1, -1), goal.expand(count, -1, -1)
    noise = BatchNoise(count, torch.Generator().manual_seed(0))
    drawn = method.act(observations, actions[:, :0].expand(count, -1, -1), goal, noise, {})
    assert drawn.mean().item() == pytest.approx(mean, abs=0.02)
    if steps is None:  # a few coarse steps with the variance of Ho et al. draw too narrowly or too widely
        assert drawn.std().item() == pytest.approx(std, rel=0.1)


def test_the_loss_is_the_squared_error_of_the_noise_in_noised_actions():
    method, data, seen = make(), batch(200, 3), []

    def network(actions, level, observations, goal, generator):
        seen.append((actions, level))
        return torch.zeros_like(actions)

    method.network.forward = network
    loss = method.loss(data, torch.Generator().manual_seed(5))
    [(noisy, level)] = seen
    steps = (10 * level).round().long()
    assert sorted(set(steps.tolist())) == list(range(1, 11))
    share = torch.cumprod(1 - torch.linspace(1e-4, 0.5, 10), 0)[steps - 1][:, None, None]
    eps = (noisy - share.sqrt() * data.actions) / (1 - share).sqrt()
    draws = torch.Generator().manual_seed(5)
    torch.randint(1, 11, (200,), generator=draws)
    assert torch.allclose(eps, torch.randn(data.actions.shape, generator=draws), atol=1e-3)
    assert loss.item() == pytest.approx(eps.square().mean().item(), rel=1e-4)


def test_an_impossible_chain_is_refused():
    with pytest.raises(ValueError, match=r"beta_min = 0\.3: must be above 0 and at most beta_max = 0\.2"):
        cx_diff.Config(TRANSFORMER, 10, 0.3, 0.2, final_goals=0.0)
