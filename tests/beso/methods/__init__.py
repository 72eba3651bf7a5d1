"""Random training samples for the tests of the methods."""

import torch

from beso.data.spec import Sizes
from beso.data.windows import Batch

SIZES = Sizes(observation=10, action=2, goal_window=1)


def batch(size, window, sizes=SIZES, seed=0):
    """Standard normal numbers; four future states, goals one to eight steps ahead."""
    generator = torch.Generator().manual_seed(seed)
    shapes = (
        (size, window, sizes.observation),
        (size, window, sizes.action),
        (size, sizes.goal_window, sizes.observation),
        (size, 4, sizes.observation),
    )
    goal_step = torch.randint(1, 9, (size,), generator=generator)
    return Batch(*(torch.randn(shape, generator=generator) for shape in shapes), goal_step)
