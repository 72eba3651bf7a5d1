import math

import pytest
import torch

from beso.core.noise import BatchNoise
from beso.errors import UserError
from beso.methods import c_bet
from tests.beso.methods import SIZES, batch

CONFIG = c_bet.Config(width=16, layers=1, heads=2, window=3, dropout=0.0, bins=3, offset_weight=10.0)
CENTRES = torch.tensor([[-0.8, 0.0], [0.1, 0.5], [0.9, -0.6]])


def make(centres=CENTRES):
    method = c_bet.Method(CONFIG, c_bet.Sampling(context_length=None), SIZES, torch.Generator().manual_seed(0))
    method.centres.copy_(centres)
    return method.eval()


def test_bins_are_the_clusters_of_the_actions():
    draws = torch.Generator().manual_seed(0)
    actions = CENTRES[torch.randint(3, (3000,), generator=draws)] + 0.05 * torch.randn(3000, 2, generator=draws)
    first, again = make(torch.zeros(3, 2)), make(torch.zeros(3, 2))
    first.prepare(actions, seed=1)
    again.prepare(actions, seed=1)
    assert torch.equal(first.centres, again.centres)
    assert (torch.cdist(CENTRES, first.centres).amin(dim=1) < 0.01).all()
    assert "centres" in first.state_dict()


def test_focal_loss_by_hand():
    logits = torch.tensor([[1.0, -0.5, 0.3], [0.0, 2.0, 0.0]], dtype=torch.float64)
    expected = 0.0
    for row, true in zip(logits.tolist(), [2, 1], strict=True):
        p = math.exp(row[true]) / sum(map(math.exp, row))
        expected -= (1 - p) ** 2 * math.log(p) / 2
    assert c_bet.focal_loss(logits, torch.tensor([2, 1])).item() == pytest.approx(expected)


def test_only_the_true_bins_offset_is_trained():
    method, data = make(), batch(6, 3)
    captured = []
    predict = method._predict

    def keep(*args):
        logits, offsets = predict(*args)
        offsets.retain_grad()
        captured.append(offsets)
        return logits, offsets

    method._predict = keep
    method.loss(data, torch.Generator()).backward()
    true = torch.cdist(data.actions.flatten(0, 1), CENTRES).argmin(dim=1)
    moved = (captured[0].grad != 0).any(dim=-1).flatten(0, 1)
    assert torch.equal(moved, torch.nn.functional.one_hot(true, 3).bool())


def test_the_loss_is_focal_loss_and_weighted_offset_error():
    method, data = make(), batch(6, 3)
    with torch.no_grad():
        logits, offsets = method._predict(data.observations, data.goal)
        errors, bins = [], torch.cdist(data.actions.flatten(0, 1), CENTRES).argmin(dim=1)
        for action, bin_, offset in zip(data.actions.flatten(0, 1), bins, offsets.flatten(0, 1), strict=True):
            errors.append((CENTRES[bin_] + offset[bin_] - action).square())
        expected = c_bet.focal_loss(logits.flatten(0, 1), bins) + 10 * torch.stack(errors).mean()
        assert method.loss(data, torch.Generator()).item() == pytest.approx(expected.item(), rel=1e-5)


def test_acting_draws_a_bin_and_adds_its_offset():
    method, count = make(), 30_000
    logits, offsets = torch.tensor([0.0, 1.0, -1.0]), torch.tensor([[0.01, 0.02], [0.03, 0.04], [0.05, 0.06]])
    method._predict = lambda observations, goal: (logits.expand(count, 1, 3), offsets.expand(count, 1, 3, 2))
    noise = BatchNoise(count, torch.Generator().manual_seed(0))
    drawn = method.act(torch.zeros(count, 1, 10), None, torch.zeros(count, 1, 10), noise, {})
    distances = torch.cdist(drawn, CENTRES + offsets)
    assert distances.amin(dim=1).max() < 1e-3
    shares = torch.bincount(distances.argmin(dim=1)) / count
    assert torch.allclose(shares, logits.softmax(0), atol=4 * 0.5 / count**0.5)


def test_the_whole_window_is_trained_and_goals_come_first():
    method, data = make(), batch(2, 3)
    logits, offsets = method._predict(data.observations, data.goal)
    assert logits.shape == (2, 3, 3)
    assert offsets.shape == (2, 3, 3, 2)
    changed, _ = method._predict(data.observations, data.goal + 1)
    assert not torch.isclose(changed, logits, atol=1e-6).all(dim=-1).any(), "every state sees the goal"
    later = data.observations.clone()
    later[:, -1] += 1
    changed, _ = method._predict(later, data.goal)
    assert torch.allclose(changed[:, :-1], logits[:, :-1], atol=1e-6), "no state sees a later one"
    assert not torch.allclose(changed[:, -1], logits[:, -1], atol=1e-6)


def test_more_bins_than_actions_are_refused():
    with pytest.raises(UserError, match="bins = 3: must be at most the number of training actions, 2"):
        make().prepare(torch.zeros(2, 2), seed=0)
