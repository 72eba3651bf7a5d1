"""Classifier-free guidance (Ho & Salimans 2021; paper, Eq. 7).

The paper mixes scores, lambda * conditional + (1 - lambda) * unconditional. The score is (D - a) / sigma^2, so mixing
denoiser outputs with the same weights is the same thing.
"""

import torch
from torch import Tensor

from beso.sampling.samplers import Denoise


def classifier_free(denoise_pair: Denoise, scale: float) -> Denoise:
    """A guided denoiser that costs one network call on a batch of 2B.

    Args:
        denoise_pair: a denoiser bound to a batch whose first half has the goals and whose second half has none.
        scale: lambda; 1 is the conditional policy, 0 the unconditional one (for these two alone a denoiser bound to
            one half is cheaper).
    """

    def denoise(a: Tensor, sigma: float) -> Tensor:
        conditional, unconditional = denoise_pair(torch.cat([a, a]), sigma).chunk(2)
        return unconditional + scale * (conditional - unconditional)

    return denoise
