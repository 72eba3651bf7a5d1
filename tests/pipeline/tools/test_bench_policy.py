import pytest

from beso import envs
from beso.errors import UserError
from pipeline import profile
from pipeline.tools.bench_policy import PUBLISHED, Published, _parts
from stages.latency import build, time_calls

CELL = profile.load("paper").cell_named("block_push-c_beso")
SIZES = envs.spec("block_push").sizes
NETWORK = """
import torch

class DiffusionGPT(torch.nn.Module):
    def __init__(self, action_dim, goal_seq_len, obs_seq_len, **sizes):
        super().__init__()
        self.action_dim, self.calls = action_dim, 0
        assert sizes["embed_dim"] == 240 and sizes["state_dim"] == 10, sizes

    def forward(self, states, actions, goals, sigma):
        assert states.shape[:2] == actions.shape[:2] and len(goals) == len(sigma)
        self.calls += 1
        return actions
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / PUBLISHED).parent.mkdir(parents=True)
    return tmp_path


def test_the_published_network_is_called_as_often_as_ours(folder):
    (folder / PUBLISHED).write_text(NETWORK)
    published = Published(folder, CELL, SIZES)
    assert len(time_calls(published, 5, SIZES, 2, 3)) == 3
    assert published._network.calls == 4 * CELL.evaluate.sampling.steps


def test_what_cannot_be_measured_is_one_line(folder):
    with pytest.raises(UserError, match="is missing: --published is a checkout"):
        Published(folder, CELL, SIZES)
    (folder / PUBLISHED).write_text("import einops_that_is_not_here")
    with pytest.raises(UserError, match="needs the package einops_that_is_not_here"):
        Published(folder, CELL, SIZES)
    with pytest.raises(UserError, match="is a C-BESO with a goal token"):
        Published(folder, profile.load("paper").cell_named("block_push-gcbc"), SIZES)


def test_parts_of_a_call_are_its_whole_time():
    policy, context = build(CELL)
    shares = _parts(policy, context, SIZES, 1)
    assert {"linear layers", "attention", "copies", "Python"} <= shares.keys()
    assert sum(shares.values()) == pytest.approx(1, abs=0.05)
