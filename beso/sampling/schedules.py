"""Noise schedules: the levels at which a sampler stops on its way from sigma_max to 0.

`schedule(steps, sigma_min, sigma_max)` returns `steps + 1` falling float64 values; the first `steps` run from sigma_max
to sigma_min, the last is 0.
"""

import math
from collections.abc import Callable

import torch
from torch import Tensor

from beso.errors import UserError

Schedule = Callable[[int, float, float], Tensor]

KARRAS_RHO = 5.0  # the published configuration's; Karras et al. recommend 7 for images
IDDPM_STEPS, IDDPM_C1, IDDPM_C2 = 1000, 0.001, 0.008
VP_BETA_D, VP_BETA_MIN = 19.9, 0.1


def _fractions(steps: int) -> Tensor:
    """0 ... 1 in `steps` equal strides; a single step sits at 0."""
    return torch.linspace(0, 1, steps, dtype=torch.float64)


def _ending_in_zero(sigmas: Tensor) -> Tensor:
    return torch.cat([sigmas, sigmas.new_zeros(1)])


def exponential(steps: int, sigma_min: float, sigma_max: float) -> Tensor:
    """Equal strides of ln(sigma); the paper's default."""
    i = _fractions(steps)
    return _ending_in_zero(torch.exp((1 - i) * math.log(sigma_max) + i * math.log(sigma_min)))


def linear(steps: int, sigma_min: float, sigma_max: float) -> Tensor:
    """Equal strides of sigma."""
    i = _fractions(steps)
    return _ending_in_zero((1 - i) * sigma_max + i * sigma_min)


def karras(steps: int, sigma_min: float, sigma_max: float) -> Tensor:
    """Equal strides of sigma^(1/rho) (Karras et al. 2022, Eq. 5)."""
    i = _fractions(steps)
    low, high = sigma_min ** (1 / KARRAS_RHO), sigma_max ** (1 / KARRAS_RHO)
    return _ending_in_zero((high + i * (low - high)) ** KARRAS_RHO)


def iddpm(steps: int, sigma_min: float, sigma_max: float) -> Tensor:
    """The cosine schedule of Nichol & Dhariwal (2021) as noise levels (Karras et al. 2022, table 1).

    Of its 1000 levels those within the range are kept and `steps` are taken at equal strides of their index, so that
    the ends are the table's nearest levels inside the range.
    """

    def alpha_bar(j: int) -> float:
        return math.sin(math.pi / 2 * j / IDDPM_STEPS / (IDDPM_C2 + 1)) ** 2

    levels = [0.0]
    for j in range(IDDPM_STEPS, 0, -1):
        ratio = max(alpha_bar(j - 1) / alpha_bar(j), IDDPM_C1)
        levels.append(math.sqrt((levels[-1] ** 2 + 1) / ratio - 1))
    inside = torch.tensor([u for u in levels if sigma_min <= u <= sigma_max][::-1], dtype=torch.float64)
    if steps > len(inside):
        raise UserError(f"steps = {steps}: iddpm has {len(inside)} levels from {sigma_min} to {sigma_max}")
    return _ending_in_zero(inside[torch.round(_fractions(steps) * (len(inside) - 1)).long()])


def ve(steps: int, sigma_min: float, sigma_max: float) -> Tensor:
    """The variance-exploding schedule of Song et al. (2021): equal strides of ln(sigma^2).

    This is the exponential schedule; that the paper's table shows a difference comes from `ve_published`.
    """
    i = _fractions(steps)
    return _ending_in_zero(torch.sqrt(sigma_max**2 * (sigma_min**2 / sigma_max**2) ** i))


def vp(steps: int, sigma_min: float, sigma_max: float) -> Tensor:
    """The variance-preserving schedule of Song et al. (2021): sigma(t) = sqrt(exp(beta_d t^2 / 2 + beta_min t) - 1).

    t takes equal strides between the times of sigma_max and sigma_min.
    """

    def time(sigma: float) -> float:
        root = math.sqrt(VP_BETA_MIN**2 + 2 * VP_BETA_D * math.log1p(sigma**2))
        return (root - VP_BETA_MIN) / VP_BETA_D

    i = _fractions(steps)
    return _vp_levels((1 - i) * time(sigma_max) + i * time(sigma_min))


def _vp_levels(t: Tensor) -> Tensor:
    return _ending_in_zero(torch.sqrt(torch.expm1(VP_BETA_D / 2 * t**2 + VP_BETA_MIN * t)))


def ve_published(steps: int, sigma_min: float, sigma_max: float) -> Tensor:
    """`ve` as the published code has it: the index runs too far, so that the levels fall past sigma_min."""
    i = torch.linspace(0, (steps + 1) / max(steps - 1, 1), steps, dtype=torch.float64)
    return _ending_in_zero(torch.sqrt(sigma_max**2 * (sigma_min**2 / sigma_max**2) ** i))


def vp_published(steps: int, sigma_min: float, sigma_max: float) -> Tensor:
    """`vp` as the published code has it, which ignores the range.

    t falls from 1 to 0.001 and sigma from 152, far outside of what the model was trained on and of the initial sample's
    scale.
    """
    return _vp_levels(torch.linspace(1, 1e-3, steps, dtype=torch.float64))


SCHEDULES: dict[str, Schedule] = {
    "exponential": exponential,
    "linear": linear,
    "karras": karras,
    "iddpm": iddpm,
    "ve": ve,
    "vp": vp,
    "ve_published": ve_published,
    "vp_published": vp_published,
}
