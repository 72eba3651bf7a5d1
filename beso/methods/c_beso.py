"""C-BESO: the goal-conditioned score-based diffusion policy (paper, "Conditioned Policy")."""

from dataclasses import dataclass

import torch

from beso.data.spec import Sizes
from beso.diffusion.score_policy import DenoiserConfig, DiffusionConfig, DiffusionSampling, ScorePolicy
from beso.networks.transformer import ScoreTransformer

Sampling = DiffusionSampling


@dataclass(frozen=True)
class Config(DenoiserConfig):
    """The network and its training noise."""

    diffusion: DiffusionConfig


class Method(ScorePolicy):
    """The policy. See beso.methods.Policy."""

    def __init__(self, config: Config, sampling: Sampling | None, sizes: Sizes, generator: torch.Generator) -> None:
        super().__init__(
            ScoreTransformer(config.transformer, *sizes, generator=generator),
            config.diffusion,
            sampling,
        )
