"""Where policies get their random numbers from at inference: from outside, one stream an episode."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
import torch
from torch import Tensor


class Noise(Protocol):
    """A source of random numbers for a batch of B episodes."""

    def normal(self, *shape: int) -> Tensor:
        """Standard normal numbers, (B, *shape)."""

    def uniform(self, *shape: int) -> Tensor:
        """Uniform numbers in [0, 1), (B, *shape)."""


class EpisodeNoise:
    """One numpy generator an episode: an episode's numbers depend on its own generator alone."""

    def __init__(self, generators: Sequence[np.random.Generator], device: torch.device | str = "cpu") -> None:
        self.generators = list(generators)
        self.device = device

    def normal(self, *shape: int) -> Tensor:
        """Standard normal numbers, (B, *shape)."""
        return self._stacked([g.standard_normal(shape, dtype=np.float32) for g in self.generators])

    def uniform(self, *shape: int) -> Tensor:
        """Uniform numbers in [0, 1), (B, *shape)."""
        return self._stacked([g.random(shape, dtype=np.float32) for g in self.generators])

    def _stacked(self, drawn: list[np.ndarray]) -> Tensor:
        return torch.from_numpy(np.stack(drawn)).to(self.device)

    def keep(self, running: np.ndarray) -> None:
        """Go on with a part of the batch, (B,) booleans."""
        self.generators = [g for g, alive in zip(self.generators, running, strict=True) if alive]


class BatchNoise:
    """One torch generator for the whole batch, where episodes do not matter (validation, benchmarks)."""

    def __init__(self, batch: int, generator: torch.Generator) -> None:
        self.batch, self.generator = batch, generator

    def normal(self, *shape: int) -> Tensor:
        """Standard normal numbers, (B, *shape)."""
        return torch.randn(self.batch, *shape, generator=self.generator, device=self.generator.device)

    def uniform(self, *shape: int) -> Tensor:
        """Uniform numbers in [0, 1), (B, *shape)."""
        return torch.rand(self.batch, *shape, generator=self.generator, device=self.generator.device)


def categorical(probabilities: Tensor, uniform: Tensor) -> Tensor:
    """Classes drawn by inverting the cumulative distribution.

    Args:
        probabilities: (..., K), or anything proportional to them.
        uniform: (..., N) numbers in [0, 1), one for each draw.

    Returns:
        (..., N) class indices.
    """
    cumulative = probabilities.cumsum(dim=-1)
    drawn = torch.searchsorted(cumulative, uniform * cumulative[..., -1:], right=True)
    return drawn.clamp_(max=probabilities.shape[-1] - 1)
