"""Training windows and goals, drawn by index arithmetic over flat tensors on the training device.

One sample from an episode of T steps, window W, goal window G (here W = 5, G = 1):

    step            0  1  2  3  4  5  6  7  8  9  ...        T-1
    observations          [o  o  o  o  o]
    actions               [a  a  a  a  a]
    goal                                  .  .  .  [g]  .  .  .     uniform in start+W ... T-G

The window starts anywhere that leaves room for a goal after it, so a goal never precedes its window, never overlaps
it, and may be the episode's last state.
"""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from beso.data.play import PlayDataset
from beso.data.scaling import Scaling
from beso.errors import UserError


class Batch(NamedTuple):
    """Scaled training samples: observations (B, W, O), actions (B, W, A), goal (B, G, O)."""

    observations: Tensor
    actions: Tensor
    goal: Tensor


class Windows:
    """All windows of some episodes of a dataset, resident on one device.

    Args:
        episodes: which episodes, indices into the dataset.
        window, goal_window: W and G.

    Raises:
        UserError: an episode is too short for a window and a goal.
    """

    def __init__(
        self,
        dataset: PlayDataset,
        episodes: np.ndarray,
        scaling: Scaling,
        window: int,
        goal_window: int,
        device: torch.device | str = "cpu",
    ) -> None:
        starts, ends = dataset.episode_starts[episodes], dataset.episode_ends[episodes]
        room = ends - starts - window - goal_window + 1  # windows of each episode
        if room.min() <= 0:
            shortest = int((ends - starts).min())
            raise UserError(
                f"window = {window}: the shortest episode has {shortest} steps, room for a window of at most"
                f" {shortest - goal_window} before a goal of {goal_window}"
            )
        first_of_episode = np.repeat(starts - np.concatenate([[0], np.cumsum(room)[:-1]]), room)
        self.window, self.goal_window = window, goal_window
        self._starts = torch.from_numpy(np.arange(room.sum()) + first_of_episode).to(device)
        self._last_goals = torch.from_numpy(np.repeat(ends - goal_window, room)).to(device)
        self._observations = scaling.observations(torch.from_numpy(np.array(dataset.observations))).to(device)
        self._goals = scaling.mask_goals(self._observations)
        self._actions = scaling.actions(torch.from_numpy(np.array(dataset.actions))).to(device)
        self._steps = torch.arange(window, device=device)
        self._goal_steps = torch.arange(goal_window, device=device)

    def __len__(self) -> int:
        """Number of different windows."""
        return len(self._starts)

    def indices(self, size: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Draw `size` windows with replacement: first steps of the windows and of their goals, each (size,)."""
        device = self._starts.device
        chosen = torch.randint(len(self), (size,), generator=generator, device=device)
        start = self._starts[chosen]
        earliest, last = start + self.window, self._last_goals[chosen]
        uniform = torch.rand(size, generator=generator, device=device, dtype=torch.float64)
        return start, earliest + (uniform * (last - earliest + 1)).long()

    def sample(self, size: int, generator: torch.Generator) -> Batch:
        """A batch of random windows with random later goals."""
        start, goal = self.indices(size, generator)
        steps = start[:, None] + self._steps
        return Batch(self._observations[steps], self._actions[steps], self._goals[goal[:, None] + self._goal_steps])
