"""What a policy carries from step to step of its episodes."""

import torch
from torch import Tensor

Memory = dict[str, Tensor]  # by name, with a row an episode; empty at the episodes' start


def replans(memory: Memory, interval: int, states: Tensor) -> Tensor:
    """Whether an episode's plan is due, every `interval` steps from its first; counts the steps in `memory`.

    Args:
        states: (B, ...) the current states, for their number and device.

    Returns:
        (B, 1) booleans.
    """
    step = memory.get("step", torch.zeros(len(states), 1, dtype=torch.long, device=states.device))
    memory["step"] = step + 1
    return step % interval == 0
