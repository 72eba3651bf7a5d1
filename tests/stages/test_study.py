"""How often one action calls the network."""

from dataclasses import replace

import pytest

from beso import envs
from pipeline import profile
from stages.study import network_calls


@pytest.fixture(scope="module")
def smoke():
    return profile.load("smoke")


@pytest.mark.parametrize(
    ("method", "changes", "calls"),
    [
        ("c_beso", {"sampler": "euler", "steps": 5}, 5),
        ("c_beso", {"sampler": "dpmpp_2m", "steps": 5}, 5),
        ("c_beso", {"sampler": "dpm_2", "steps": 5}, 9),
        ("c_beso", {"sampler": "heun", "steps": 5, "context": "published"}, 9),
        ("cfg_beso", {"guidance_scale": 2.0}, 3),  # on pairs
        ("cx_diff", {"steps": 3}, 3 + 8),
        ("cx_diff", {"steps": None}, 20 + 8),
        ("gcbc", {}, 1),
        ("c_bet", {}, 1),
    ],
)
def test_calls_are_counted(smoke, method, changes, calls):
    cell = smoke.cell("block_push", method)
    model, sampling = cell.train.first.config.model, replace(cell.evaluate.sampling, **changes)
    assert network_calls(method, model, sampling, envs.spec("block_push").sizes) == calls
