"""Training-noise densities p_train(sigma), truncated to [sigma_min, sigma_max], as inverse distribution functions.

Each function maps uniform numbers in [0, 1) to noise levels: `density(uniform, sigma_min, sigma_max, location, scale)`.
The mapping runs in float64 because the truncated tails are far out.
"""

import functools
import math
from collections.abc import Callable

import torch
from torch import Tensor

Density = Callable[[Tensor, float, float, float, float], Tensor]


@functools.lru_cache  # a number: a tensor would be copied to a GPU at every step, which waits for it
def _share_below(distribution: Callable[[Tensor], Tensor], sigma: float, location: float, scale: float) -> float:
    """The share of noise levels below sigma, before the truncation."""
    return distribution(torch.tensor((math.log(sigma) - location) / scale, dtype=torch.float64)).item()


def log_logistic(uniform: Tensor, sigma_min: float, sigma_max: float, location: float, scale: float) -> Tensor:
    """ln(sigma) is logistic with the given location and scale.

    The paper's LogLogistic(alpha=0.5, beta=0.5) has the median alpha and, for ln(sigma), the scale beta: location
    ln(0.5), scale 0.5.
    """
    low, high = (_share_below(torch.sigmoid, sigma, location, scale) for sigma in (sigma_min, sigma_max))
    return torch.exp(location + scale * torch.logit(low + (high - low) * uniform.double()))


def log_normal(uniform: Tensor, sigma_min: float, sigma_max: float, location: float, scale: float) -> Tensor:
    """ln(sigma) is normal with the given mean and standard deviation (Karras et al. 2022)."""
    low, high = (_share_below(torch.special.ndtr, sigma, location, scale) for sigma in (sigma_min, sigma_max))
    sigma = torch.exp(location + scale * torch.special.ndtri(low + (high - low) * uniform.double()))
    return sigma.clamp(sigma_min, sigma_max)  # rounding at the ends of [0, 1] would reach 0 and infinity


def uniform(uniform: Tensor, sigma_min: float, sigma_max: float, location: float, scale: float) -> Tensor:
    """sigma is uniform; location and scale have no meaning here."""
    return sigma_min + (sigma_max - sigma_min) * uniform.double()


DENSITIES: dict[str, Density] = {"log_logistic": log_logistic, "log_normal": log_normal, "uniform": uniform}
