"""Golden values are those of the published code's schedules, computed with its own functions (n = 3)."""

import math

import pytest
import torch

from beso.errors import UserError
from beso.sampling.schedules import SCHEDULES, VP_BETA_D, VP_BETA_MIN

RANGES = [(0.005, 1.0), (0.05, 1.0)]
GOLDEN = {
    ("exponential", RANGES[0]): ["1", ".0707", ".005", "0"],
    ("linear", RANGES[0]): ["1", ".5025", ".005", "0"],
    ("karras", RANGES[0]): ["1", ".1384", ".005", "0"],
    ("iddpm", RANGES[0]): [".9998", ".4213", ".0064", "0"],
    ("exponential", RANGES[1]): ["1", ".2236", ".05", "0"],
    ("linear", RANGES[1]): ["1", ".525", ".05", "0"],
    ("karras", RANGES[1]): ["1", ".2789", ".05", "0"],
    ("iddpm", RANGES[1]): [".9998", ".4454", ".0515", "0"],
    ("ve_published", RANGES[0]): ["1", ".005", ".000025", "0"],
    ("ve_published", RANGES[1]): ["1", ".05", ".0025", "0"],
    ("vp_published", RANGES[0]): ["152.2", "3.42", ".0105", "0"],
    ("vp_published", RANGES[1]): ["152.2", "3.42", ".0105", "0"],
}


@pytest.mark.parametrize(("name", "limits"), GOLDEN)
def test_three_steps_are_those_of_the_published_code(name, limits):
    for value, text in zip(SCHEDULES[name](3, *limits).tolist(), GOLDEN[name, limits], strict=True):
        unit = 10.0 ** -len(text.partition(".")[2]) if "." in text else 1e-9
        assert value == pytest.approx(float(text), abs=unit / 2)


@pytest.mark.parametrize("limits", RANGES)
@pytest.mark.parametrize("steps", [1, 2, 3, 10, 50])
@pytest.mark.parametrize("name", [name for name in SCHEDULES if not name.endswith("published")])
def test_falls_strictly_from_sigma_max_to_sigma_min_and_ends_in_zero(name, steps, limits):
    sigma_min, sigma_max = limits
    sigmas = SCHEDULES[name](steps, sigma_min, sigma_max)
    assert sigmas.dtype == torch.float64
    assert len(sigmas) == steps + 1
    assert (sigmas.diff() < 0).all()
    assert sigmas[-1] == 0
    # iddpm's ends are the nearest of the table's levels; they lie about 0.0015 apart at both ends.
    slack = 0.002 if name == "iddpm" else 1e-12
    assert sigma_max - slack <= sigmas[0] <= sigma_max * (1 + 1e-12)
    if steps > 1:
        assert sigma_min * (1 - 1e-12) <= sigmas[-2] <= sigma_min + slack


@pytest.mark.parametrize("limits", RANGES)
@pytest.mark.parametrize("steps", [1, 3, 20])
def test_ve_is_the_exponential_schedule(steps, limits):
    assert torch.allclose(SCHEDULES["ve"](steps, *limits), SCHEDULES["exponential"](steps, *limits), rtol=1e-12)


def vp_level(t):
    return math.sqrt(math.exp(VP_BETA_D * t**2 / 2 + VP_BETA_MIN * t) - 1)


def test_vp_over_the_published_codes_range_has_its_values():
    """The published code runs t from 1 to 0.001 whatever the range: 152.2, 3.42, 0.0105."""
    sigmas = SCHEDULES["vp"](3, vp_level(1e-3), vp_level(1.0)).tolist()
    assert sigmas[0] == pytest.approx(152.2, abs=0.05)
    assert sigmas[1] == pytest.approx(3.42, abs=0.005)
    assert sigmas[2] == pytest.approx(0.0105, abs=0.00005)


@pytest.mark.parametrize("limits", RANGES)
def test_vp_stops_at_equal_strides_of_time(limits):
    sigmas = SCHEDULES["vp"](9, *limits).tolist()[:-1]

    def time(sigma):
        """The time of a level, by bisection."""
        low, high = 0.0, 1.0
        for _ in range(60):
            middle = (low + high) / 2
            low, high = (middle, high) if vp_level(middle) < sigma else (low, middle)
        return low

    strides = torch.tensor([time(s) for s in sigmas], dtype=torch.float64).diff()
    assert torch.allclose(strides, strides.mean().expand_as(strides), rtol=1e-9)


def test_strides_are_equal_in_the_variable_of_each_schedule():
    levels = {name: SCHEDULES[name](7, 0.01, 2.0)[:-1] for name in ("exponential", "linear", "karras")}
    for variable in (levels["exponential"].log(), levels["linear"], levels["karras"] ** (1 / 5)):
        strides = variable.diff()
        assert torch.allclose(strides, strides.mean().expand_as(strides), rtol=1e-12)


def test_iddpm_refuses_more_steps_than_its_table_has_levels():
    assert (SCHEDULES["iddpm"](471, 0.05, 1.0).diff() < 0).all()
    with pytest.raises(UserError, match=r"steps = 472: iddpm has 471 levels from 0\.05 to 1\.0"):
        SCHEDULES["iddpm"](472, 0.05, 1.0)
