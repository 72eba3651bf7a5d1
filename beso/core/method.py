"""What the modules of beso.methods inherit: Config, Sampling and Method of one method."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

from beso.config import require, require_positive

if TYPE_CHECKING:  # a cell that only checks parameters does not depend on these
    import torch
    from torch import Tensor

    from beso.core.memory import Memory
    from beso.core.noise import Noise
    from beso.data.spec import Sizes
    from beso.data.windows import Batch


class SamplingConfig:
    """What a method's Sampling inherits."""

    @classmethod
    def default(cls, config: Any) -> Any:
        """The Sampling that a Method of this Config acts by where none is chosen; None where it has its own default."""
        return None

    def context_steps(self, trained: int) -> int:
        """Time steps of the context in rollouts, for a policy whose training suggests `trained`.

        A Sampling that has a `context_length` may ask for another number.
        """
        return getattr(self, "context_length", None) or trained


@dataclass(frozen=True)
class ContextSampling(SamplingConfig):
    """The Sampling of a method that lets one choose its context alone.

    Attributes:
        context_length: time steps of the context in rollouts; null takes the training window.
    """

    context_length: int | None

    def __post_init__(self) -> None:
        require_positive(self, "context_length")


class ModelConfig:
    """What a method's Config inherits: the windows it is trained on (beso.data.windows), and what it checks.

    Attributes:
        final_goals: share of the windows whose goal is the episode's last state, or the last that the goal horizon
            allows; the others' are uniform in the future.
    """

    final_goals: float = 0.0

    if TYPE_CHECKING:

        @property
        def window(self) -> int:
            """Time steps in a training window; every Config has it."""

    @property
    def context(self) -> int:
        """Time steps of the context in rollouts, unless the sampling asks for fewer."""
        return self.window

    @property
    def lookahead(self) -> int:
        """States after the window that the loss sees."""
        return 0

    def check(self, sampling: Any) -> None:
        """Raise ValueError where a Sampling does not fit."""
        length = sampling.context_steps(self.context)
        require(length <= self.window, f"context_length = {length}: must be at most the model's window, {self.window}")

    def check_teacher(self, teacher: ModelConfig | None) -> None:
        """Raise ValueError unless a model can learn from a trained one of this configuration, or, None, from play."""
        require(teacher is None, "learns from play data, not from a teacher")


class BaseMethod(Protocol):
    """What training and rollouts ask of a method's Method, a torch.nn.Module. All tensors are scaled."""

    def __init__(self, config: Any, sampling: Any, sizes: Sizes, generator: torch.Generator) -> None:
        """`sampling` None means the method's default. Initial weights are drawn from `generator`."""

    def loss(self, batch: Batch, generator: torch.Generator) -> Tensor:
        """Loss of a batch, a scalar, with random numbers from `generator`; dropout only in training mode."""

    def act(self, observations: Tensor, actions: Tensor, goal: Tensor, noise: Noise, memory: Memory) -> Tensor:
        """(B, T, O), (B, T-1, A), (B, G, O) -> next action (B, A). `memory` may be changed."""

    def learn_from(self, teacher: Any) -> None:
        """Before training, of a method whose `check_teacher` allows it: take a trained policy for a teacher."""

    def prepare(self, actions: Tensor, seed: int) -> None:
        """Look at all scaled training actions (N, A) before the first update."""

    def schedule(self, done: float) -> bool:
        """Adapt the loss to the share of the training that is done, from 0 to 1. Called before every update.

        Returns:
            Whether the loss computes something else from now on. A CUDA graph of it is then recorded anew.
        """
        return False

    def settle(self) -> None:
        """Renew what was measured with older weights.

        Training calls it on the averaged weights, before it measures or saves them.
        """
