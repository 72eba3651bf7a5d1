"""C-BESO: the goal-conditioned score-based diffusion policy (paper, "Conditioned Policy")."""

from dataclasses import dataclass

import torch

from beso.data.spec import Sizes
from beso.diffusion.score_policy import DiffusionConfig, DiffusionSampling, ScorePolicy
from beso.methods import ModelConfig
from beso.networks.transformer import ScoreTransformer, TransformerConfig

Sampling = DiffusionSampling


@dataclass(frozen=True)
class Config(ModelConfig):
    """The network and its training noise."""

    transformer: TransformerConfig
    diffusion: DiffusionConfig

    @property
    def window(self) -> int:
        """Time steps in a training window and in the context of `act`."""
        return self.transformer.window


class Method(ScorePolicy):
    """The policy. See beso.methods.Policy."""

    def __init__(self, config: Config, sampling: Sampling | None, sizes: Sizes, generator: torch.Generator) -> None:
        super().__init__(
            ScoreTransformer(config.transformer, *sizes, generator=generator),
            config.diffusion,
            sampling,
        )
