"""EDM preconditioning of the score network (Karras et al. 2022, table 1; paper, appendix "Preconditioning").

D(a, s, g, sigma) = c_skip(sigma) a + c_out(sigma) F(c_in(sigma) a, s, g, c_noise(sigma))
"""

from typing import NamedTuple

import torch
from torch import Tensor


class Scales(NamedTuple):
    """The four conditioning functions at some noise levels, each of the shape of sigma."""

    skip: Tensor
    out: Tensor
    into: Tensor
    noise: Tensor


def scales(sigma: Tensor, sigma_data: float) -> Scales:
    """c_skip, c_out, c_in and c_noise for noise levels `sigma` > 0 of any shape."""
    total = sigma**2 + sigma_data**2
    return Scales(
        skip=sigma_data**2 / total,
        out=sigma * sigma_data * total.rsqrt(),
        into=total.rsqrt(),
        noise=sigma.log() / 4,
    )


def network_target(clean: Tensor, noisy: Tensor, at: Scales) -> Tensor:
    """What F must return so that D returns `clean`.

    The mean squared error of F against this target is the paper's loss (Eq. 6) with the weight
    alpha(sigma) = 1 / c_out^2 = (sigma^2 + sigma_data^2) / (sigma sigma_data)^2.
    """
    return (clean - at.skip * noisy) / at.out


def broadcast_to_actions(at: Scales) -> Scales:
    """Scales of shape (B,) as (B, 1, 1), to multiply actions (B, T, A)."""
    return Scales(*(torch.unsqueeze(torch.unsqueeze(value, -1), -1) for value in at))
