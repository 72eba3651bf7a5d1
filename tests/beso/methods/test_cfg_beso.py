"""What CFG-BESO loses of its goals in training."""

import pytest
import torch

from beso import methods
from beso.config import build
from tests.beso.methods import SIZES, batch


@pytest.mark.parametrize(("of", "share_of_whole_goals"), [("goal", 0.3), ("element", 0.0)])
def test_whole_goals_or_single_entries_are_lost_in_training_alone(small_models, of, share_of_whole_goals):
    module, seen = methods.load("cfg_beso"), []
    values = {**small_models["cfg_beso"][0], "goal_dropout": 0.3, "goal_dropout_of": of, "null_goal": "zeros"}
    config = build(module.Config, values, "model")
    policy = module.Method(config, None, SIZES, torch.Generator().manual_seed(0))
    policy.network.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[3]))
    given = batch(400, config.window)
    for mode in (policy.eval, policy.train):
        mode().loss(given, torch.Generator().manual_seed(0))
    measured, trained = seen
    assert torch.equal(measured, given.goal)
    lost = trained == 0
    assert torch.equal(trained[~lost], given.goal[~lost])
    assert lost.float().mean() == pytest.approx(0.3, abs=0.05)
    assert lost.flatten(1).all(dim=1).float().mean() == pytest.approx(share_of_whole_goals, abs=0.05)
