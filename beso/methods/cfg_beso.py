"""CFG-BESO: one network trained with and without its goal (paper, "Goal-Classifier-Free Guided Policy").

At test time the guidance scale lambda decides: 1 follows the goal, 0 ignores it (a goal-independent policy), above 1
exaggerates what the goal changes.
"""

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from beso.config import require, require_rate
from beso.data.spec import Sizes
from beso.data.windows import Batch
from beso.diffusion.score_policy import Acting, DenoiserConfig, DiffusionConfig, ScorePolicy
from beso.networks.transformer import ScoreTransformer

SAMPLING = "beso.sampling.diffusion:GuidedSampling"


@dataclass(frozen=True)
class Config(DenoiserConfig):
    """The network, its training noise, and how it learns to do without a goal.

    Attributes:
        goal_dropout: share of samples trained without their goal; or, by element, of each goal's entries that are lost.
        goal_dropout_of: "goal", whole goals; or "element", single entries of goals, each by itself, as in the published
            code, which so drops hardly any goal whole.
        goal_dropout_from: share of the training before which no goal is dropped.
        null_goal: what stands for no goal: "zeros" in scaled units, or "learned", a goal of its own. Zeros are also the
            mean of all goals, and so a goal that a demonstration could have.
    """

    diffusion: DiffusionConfig
    goal_dropout: float
    goal_dropout_of: Literal["goal", "element"]
    goal_dropout_from: float
    null_goal: Literal["zeros", "learned"]

    def __post_init__(self) -> None:
        super().__post_init__()
        require_rate(self, "goal_dropout", "goal_dropout_from")
        require(
            self.goal_dropout_of == "goal" or self.goal_dropout_from == 0,
            f"goal_dropout_from = {self.goal_dropout_from}: must be 0 where goal_dropout_of is element",
        )


class Method(ScorePolicy):
    """The policy. See beso.core.method.BaseMethod."""

    def __init__(self, config: Config, sampling: Acting | None, sizes: Sizes, generator: torch.Generator) -> None:
        whole = config.goal_dropout_of == "goal"
        super().__init__(
            ScoreTransformer(config.transformer, *sizes, generator=generator),
            config.diffusion,
            sampling,
            goal_dropout=config.goal_dropout if whole else 0.0,
            goal_dropout_from=config.goal_dropout_from,
            null_goal=torch.ones(sizes.goal_window, sizes.observation) if config.null_goal == "learned" else None,
        )
        self.element_dropout = 0.0 if whole else config.goal_dropout

    def loss(self, batch: Batch, generator: torch.Generator) -> Tensor:
        """As ScorePolicy's, of goals that may have lost entries."""
        if self.element_dropout and self.training:
            draws = torch.rand(batch.goal.shape, generator=generator, device=batch.goal.device)
            goal = torch.where(draws >= self.element_dropout, batch.goal, self.without_goal(batch.goal))
            batch = batch._replace(goal=goal)
        return super().loss(batch, generator)
