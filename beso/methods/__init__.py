"""The methods of the paper's comparison, one module each, named as in `grid.methods`.

A module defines

    Config       what shapes the network (`methods.<name>.train.<env>.model`); has a `window`, and may have `lookahead`
                 and `goal_at_end` (see beso.data.windows) and a `context` shorter than its window
    Sampling     what only action generation needs (`methods.<name>.sample.<env>`); may have a `context_length`
    Method       the policy

Modules are imported by name, so that a pipeline cell depends on its own method's file and on no other's.
"""

from __future__ import annotations

import importlib
import pkgutil
from typing import TYPE_CHECKING, Any, Protocol

from beso.config import require
from beso.errors import UserError

if TYPE_CHECKING:  # a cell that only checks parameters does not depend on these
    import torch
    from torch import Tensor

    from beso.data.spec import Sizes
    from beso.data.windows import Batch
    from beso.memory import Memory
    from beso.noise import Noise


class Method(Protocol):
    """What training and rollouts ask of a policy. All tensors are scaled."""

    def __init__(self, config: Any, sampling: Any, sizes: Sizes, generator: torch.Generator) -> None:
        """`sampling` None means the method's default, with which validation errors are measured."""

    def loss(self, batch: Batch, generator: torch.Generator) -> Tensor:
        """Loss of a batch, a scalar, with random numbers from `generator`; dropout only in training mode."""

    def act(self, observations: Tensor, actions: Tensor, goal: Tensor, noise: Noise, memory: Memory) -> Tensor:
        """(B, T, O), (B, T-1, A), (B, G, O) -> next action (B, A). `memory` may be changed."""

    def prepare(self, actions: Tensor, seed: int) -> None:
        """Optional: look at all scaled training actions (N, A) before the first update."""

    def state_dict(self) -> dict[str, Tensor]:
        """Weights by name."""


def context_length(config: Any, sampling: Any) -> int:
    """Time steps of the context in rollouts, from a method's Config and Sampling: the training window or fewer."""
    return getattr(sampling, "context_length", None) or getattr(config, "context", config.window)


def check_sampling(config: Any, sampling: Any) -> None:
    """Raise ValueError where a method's Sampling does not fit its Config."""
    length = context_length(config, sampling)
    require(length <= config.window, f"context_length = {length}: must be at most the model's window, {config.window}")
    chain, steps = getattr(config, "diffusion_steps", None), getattr(sampling, "steps", None)
    require(not chain or not steps or steps <= chain, f"steps = {steps}: must be at most diffusion_steps, {chain}")


def names() -> list[str]:
    """Names of all methods."""
    return sorted(m.name for m in pkgutil.iter_modules(__path__))


def load(name: str) -> Any:
    """The module of one method.

    Raises:
        UserError: no such method.
    """
    if name not in names():
        raise UserError(f"method {name!r} is not one of {', '.join(names())}")
    return importlib.import_module(f"beso.methods.{name}")
