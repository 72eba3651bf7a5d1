"""RIL: relay imitation learning (Gupta et al. 2019; paper, "Relay Imitation Learning").

A high-level MLP proposes the state that should be reached a fixed number of steps ahead, a low-level MLP the action
that leads there. Both are trained by mean squared error on relabelled demonstrations; the paper uses no fine-tuning.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from beso.config import require_positive
from beso.core.memory import Memory, replans
from beso.core.method import BaseMethod, ModelConfig, SamplingConfig
from beso.core.noise import Noise
from beso.data.spec import Sizes
from beso.data.windows import Batch
from beso.networks.mlp import MLP


@dataclass(frozen=True)
class Config(ModelConfig):
    """Size of the two MLPs, and their horizon.

    Attributes:
        width, layers: neurons a hidden layer and number of hidden layers.
        horizon: steps from a state to its sub-goal; the low level learns every distance up to it.
    """

    width: int
    layers: int
    horizon: int

    def __post_init__(self) -> None:
        require_positive(self, "width", "layers", "horizon")

    @property
    def window(self) -> int:
        """Both levels look at the current state alone."""
        return 1

    @property
    def lookahead(self) -> int:
        """Sub-goals are states that follow."""
        return self.horizon


@dataclass(frozen=True)
class Sampling(SamplingConfig):
    """How the policy acts.

    Attributes:
        replan: steps between two proposals of a sub-goal.
    """

    replan: int

    def __post_init__(self) -> None:
        require_positive(self, "replan")


class Method(nn.Module, BaseMethod):
    """The policy, see BaseMethod. Its memory holds the sub-goal and the steps since the episode's start."""

    def __init__(self, config: Config, sampling: Sampling | None, sizes: Sizes, generator: torch.Generator) -> None:
        super().__init__()
        self.horizon, self.replan = config.horizon, sampling.replan if sampling else 1
        state, goal = sizes.observation, sizes.observation * sizes.goal_window
        self.high = MLP(state + goal, state, config.width, config.layers, 0.0, generator)
        self.low = MLP(state + state, sizes.action, config.width, config.layers, 0.0, generator)

    def _propose(self, observation: Tensor, goal: Tensor) -> Tensor:
        return self.high(torch.cat([observation, goal.flatten(1)], dim=1))

    def loss(self, batch: Batch, generator: torch.Generator) -> Tensor:
        """Mean squared errors of sub-goal and action, added; no parameter is in both.

        The sub-goal of a goal nearer than the horizon is the state at the goal's step. The low level's sub-goal lies a
        uniform number of steps ahead, at most the horizon.
        """
        state, rows = batch.observations[:, -1], torch.arange(len(batch.goal), device=batch.goal.device)
        proposed = self._propose(state, batch.goal)
        sub_goal = batch.future[rows, batch.goal_step.clamp(max=self.horizon) - 1]
        ahead = torch.randint(self.horizon, (len(rows),), generator=generator, device=rows.device)
        action = self.low(torch.cat([state, batch.future[rows, ahead]], dim=1))
        high = functional.mse_loss(proposed.float(), sub_goal)
        return high + functional.mse_loss(action.float(), batch.actions[:, -1])

    def act(self, observations: Tensor, actions: Tensor, goal: Tensor, noise: Noise, memory: Memory) -> Tensor:
        """(B, T, O), (B, T-1, A), (B, G, O) -> (B, A)."""
        state = observations[:, -1]
        proposed = self._propose(state, goal)
        sub_goal = torch.where(replans(memory, self.replan, state), proposed, memory.get("sub_goal", proposed))
        memory["sub_goal"] = sub_goal
        return self.low(torch.cat([state, sub_goal], dim=1))
