"""CFG-BESO: one network trained with and without its goal (paper, "Goal-Classifier-Free Guided Policy").

At test time the guidance scale lambda decides: 1 follows the goal, 0 ignores it (a goal-independent policy), above 1
exaggerates what the goal changes.
"""

from dataclasses import dataclass

import torch

from beso.config import require_rate
from beso.data.spec import Sizes
from beso.diffusion.score_policy import DiffusionConfig, SamplingConfig, ScorePolicy, validation_sampling
from beso.networks.transformer import ScoreTransformer, TransformerConfig


@dataclass(frozen=True)
class Config:
    """The network, its training noise, and the share of samples trained without a goal."""

    transformer: TransformerConfig
    diffusion: DiffusionConfig
    goal_dropout: float

    def __post_init__(self) -> None:
        require_rate(self, "goal_dropout")

    @property
    def window(self) -> int:
        """Time steps in a training window and in the context of `act`."""
        return self.transformer.window


@dataclass(frozen=True)
class Sampling(SamplingConfig):
    """As for C-BESO, and the guidance scale lambda."""

    guidance_scale: float


class Method(ScorePolicy):
    """The policy. See beso.methods.Method."""

    def __init__(self, config: Config, sampling: Sampling | None, sizes: Sizes, generator: torch.Generator) -> None:
        super().__init__(
            ScoreTransformer(config.transformer, *sizes, generator=generator),
            config.diffusion,
            sampling or validation_sampling(config.diffusion),
            goal_dropout=config.goal_dropout,
            guidance_scale=sampling.guidance_scale if sampling else 1.0,
        )
