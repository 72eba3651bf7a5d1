"""GCBC: goal-conditioned behaviour cloning (Lynch et al. 2020; paper, "Baselines Implementation").

An MLP maps the current state and the goal to one action and is trained by mean squared error, so that it averages over
the modes of the data.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from beso.config import require_positive, require_rate
from beso.core.memory import Memory
from beso.core.method import BaseMethod, ModelConfig, SamplingConfig
from beso.core.noise import Noise
from beso.data.spec import Sizes
from beso.data.windows import Batch
from beso.networks.mlp import MLP


@dataclass(frozen=True)
class Config(ModelConfig):
    """Size of the MLP.

    Attributes:
        width, layers: neurons a hidden layer and number of hidden layers.
        dropout: rate after every hidden layer.
    """

    width: int
    layers: int
    dropout: float

    def __post_init__(self) -> None:
        require_positive(self, "width", "layers")
        require_rate(self, "dropout")

    @property
    def window(self) -> int:
        """Behaviour cloning looks at the current state alone."""
        return 1


@dataclass(frozen=True)
class Sampling(SamplingConfig):
    """Nothing to choose: the policy is deterministic."""


class Method(nn.Module, BaseMethod):
    """The policy. See beso.core.method.BaseMethod."""

    def __init__(self, config: Config, sampling: Sampling | None, sizes: Sizes, generator: torch.Generator) -> None:
        super().__init__()
        inputs = sizes.observation * (1 + sizes.goal_window)
        self.network = MLP(inputs, sizes.action, config.width, config.layers, config.dropout, generator)

    def _predict(self, observation: Tensor, goal: Tensor, dropout: torch.Generator | None = None) -> Tensor:
        return self.network(torch.cat([observation, goal.flatten(1)], dim=1), dropout)

    def loss(self, batch: Batch, generator: torch.Generator) -> Tensor:
        """Mean squared error of the window's last action."""
        predicted = self._predict(batch.observations[:, -1], batch.goal, generator if self.training else None)
        return functional.mse_loss(predicted.float(), batch.actions[:, -1])

    def act(self, observations: Tensor, actions: Tensor, goal: Tensor, noise: Noise, memory: Memory) -> Tensor:
        """(B, T, O), (B, T-1, A), (B, G, O) -> (B, A)."""
        return self._predict(observations[:, -1], goal)
