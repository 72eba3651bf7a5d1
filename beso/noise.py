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


class EpisodeNoise:
    """One numpy generator an episode: an episode's numbers depend on its own generator alone."""

    def __init__(self, generators: Sequence[np.random.Generator], device: torch.device | str = "cpu") -> None:
        self.generators = list(generators)
        self.device = device

    def normal(self, *shape: int) -> Tensor:
        """Standard normal numbers, (B, *shape)."""
        drawn = np.stack([g.standard_normal(shape, dtype=np.float32) for g in self.generators])
        return torch.from_numpy(drawn).to(self.device)

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
