import pytest
import torch

from beso.methods import ril
from tests.beso.methods import SIZES, batch


def make(replan=3, horizon=4):
    config = ril.Config(width=16, layers=2, horizon=horizon)
    return ril.Method(config, ril.Sampling(replan), SIZES, torch.Generator().manual_seed(0)).eval()


def test_sub_goals_are_kept_until_the_next_plan():
    method, memory, sub_goals = make(replan=3), {}, []
    goal = batch(2, 1).goal
    with torch.no_grad():
        for i in range(7):
            observations = batch(2, 1, seed=i).observations
            action = method.act(observations, torch.zeros(2, 0, 2), goal, None, memory)
            sub_goals.append(memory["sub_goal"])
            proposed = method._propose(observations[:, -1], goal)
            assert torch.equal(sub_goals[-1], proposed if i % 3 == 0 else sub_goals[-2])
            assert torch.equal(action, method.low(torch.cat([observations[:, -1], sub_goals[-1]], dim=1)))


def test_levels_learn_their_relabelled_targets():
    """With the outputs forced to zero, the loss is the mean square of both targets."""
    method, data = make(), batch(50, 1)
    with torch.no_grad():
        for level in (method.high, method.low):
            level.output.weight.zero_()
            level.output.bias.zero_()
    rows = zip(data.future, data.goal_step.tolist(), strict=True)
    targets = torch.stack([future[min(step, 4) - 1] for future, step in rows])
    expected = targets.square().mean() + data.actions.square().mean()
    assert method.loss(data, torch.Generator()).item() == pytest.approx(expected.item(), rel=1e-5)


def test_the_low_level_sees_every_distance_up_to_the_horizon_and_the_high_level_the_goal():
    method, seen, data = make(), {}, batch(400, 1)
    for name, level in (("high", method.high), ("low", method.low)):
        level.register_forward_pre_hook(lambda _, inputs, name=name: seen.update({name: inputs[0]}))
    method.loss(data, torch.Generator().manual_seed(0))
    states, sub_goals = seen["low"].split(SIZES.observation, dim=1)
    assert torch.equal(states, data.observations[:, -1])
    distances = [(data.future[i] == sub_goal).all(dim=1).nonzero().item() for i, sub_goal in enumerate(sub_goals)]
    assert set(distances) == {0, 1, 2, 3}
    assert torch.equal(seen["high"], torch.cat([data.observations[:, -1], data.goal[:, 0]], dim=1))


def test_impossible_values_are_refused():
    with pytest.raises(ValueError, match="replan = 0: must be at least 1"):
        ril.Sampling(0)
    with pytest.raises(ValueError, match="horizon = 0: must be at least 1"):
        ril.Config(16, 2, 0)
