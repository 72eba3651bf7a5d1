"""C-BESO: the goal-conditioned score-based diffusion policy (paper, "Conditioned Policy")."""

from dataclasses import dataclass

import torch

from beso.data.spec import Sizes
from beso.diffusion.score_policy import Acting, DenoiserConfig, DiffusionConfig, ScorePolicy
from beso.networks.transformer import ScoreTransformer

SAMPLING = "beso.sampling.diffusion:DiffusionSampling"


@dataclass(frozen=True)
class Config(DenoiserConfig):
    """The network and its training noise."""

    diffusion: DiffusionConfig


class Method(ScorePolicy):
    """The policy. See beso.core.method.BaseMethod."""

    def __init__(self, config: Config, sampling: Acting | None, sizes: Sizes, generator: torch.Generator) -> None:
        super().__init__(
            ScoreTransformer(config.transformer, *sizes, generator=generator),
            config.diffusion,
            sampling,
        )
