"""Training windows and goals, drawn by index arithmetic over flat tensors on the training device.

One sample from an episode of T steps, window W, goal window G (here W = 5, G = 1):

    step            0  1  2  3  4  5  6  7  8  9  ...        T-1
    observations          [o  o  o  o  o]
    actions               [a  a  a  a  a]
    goal                                  .  .  .  [g]  .  .  .     uniform in start+W ... T-G

The window starts anywhere that leaves room for a goal after it, so a goal never precedes its window, never overlaps
it, and may be the episode's last state; with a horizon H it starts at most H steps after the window's last state, as
hours of play without a cut need it. A share of the windows (`final_goals`) may have the last goal possible instead of
a uniform one, as rollouts have demonstrations' last states for goals. `lookahead` adds the states that follow a window:

    step            0  1  2  3  4  5  6  7  8  9  ...        T-1
    future, L = 3                         [f  f  f]              the last state again where the episode is over
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from beso.data.play import PlayDataset
from beso.data.scaling import Scaling
from beso.errors import UserError

NOTHING = torch.empty(0)


class Batch(NamedTuple):
    """Scaled training samples.

    Attributes:
        observations, actions: (B, W, O) and (B, W, A).
        goal: (B, G, O), masked dimensions zero; less the window's first state where goals are relative.
        future: (B, L, O) the states after the window, not masked.
        goal_step: (B,) steps from the window's last state to the goal's first.

    A dataset of frames has numbers of steps in place of states, so O is 1, and goals are not relative yet.
    """

    observations: Tensor
    actions: Tensor
    goal: Tensor
    future: Tensor = NOTHING
    goal_step: Tensor = NOTHING


@dataclass(frozen=True)
class WindowConfig:
    """Windows and their goals, in steps; see the module.

    Attributes:
        window, goal_window: W and G.
        lookahead: L.
        goal_horizon: H, or None for the rest of the episode.
        final_goals: share of windows, below 1, whose goal is the last one possible instead of a uniform one.
    """

    window: int
    goal_window: int
    lookahead: int = 0
    goal_horizon: int | None = None
    final_goals: float = 0.0


class Windows:
    """All windows of some episodes of a dataset, resident on one device.

    Args:
        episodes: which episodes, indices into the dataset.

    Raises:
        UserError: an episode is too short for a window and a goal.
    """

    def __init__(
        self,
        dataset: PlayDataset,
        episodes: np.ndarray,
        scaling: Scaling,
        config: WindowConfig,
        device: torch.device | str = "cpu",
    ) -> None:
        window, goal_window = config.window, config.goal_window
        starts, ends = dataset.episode_starts[episodes], dataset.episode_ends[episodes]
        room = ends - starts - window - goal_window + 1  # windows of each episode
        if room.min() <= 0:
            shortest = int((ends - starts).min())
            raise UserError(
                f"window = {window}: the shortest episode has {shortest} steps, room for a window of at most"
                f" {shortest - goal_window} before a goal of {goal_window}"
            )
        first_of_episode = np.repeat(starts - np.concatenate([[0], np.cumsum(room)[:-1]]), room)
        self.config = config
        self._starts = torch.from_numpy(np.arange(room.sum()) + first_of_episode).to(device)
        self._last_steps = torch.from_numpy(np.repeat(ends - 1, room)).to(device)
        last_goals = np.repeat(ends - goal_window, room)
        if config.goal_horizon is not None:
            last_states = np.arange(room.sum()) + first_of_episode + window - 1
            last_goals = np.minimum(last_goals, last_states + config.goal_horizon)
        self._last_goals = torch.from_numpy(last_goals).to(device)
        self._scaling = scaling if dataset.frame_size is None else None
        if self._scaling:
            self._observations = scaling.scale_observations(torch.from_numpy(np.array(dataset.observations))).to(device)
            self._goals = scaling.mask_goals(self._observations)
        else:  # frames would not fit; what encodes them reads those of a batch
            self._observations = self._goals = torch.arange(len(dataset.observations), device=device)[:, None]
        self._actions = scaling.scale_actions(torch.from_numpy(np.array(dataset.actions))).to(device)
        self._steps = torch.arange(window, device=device)
        self._goal_steps = torch.arange(goal_window, device=device)
        self._future_steps = window + torch.arange(config.lookahead, device=device)

    def __len__(self) -> int:
        """Number of different windows."""
        return len(self._starts)

    @property
    def actions(self) -> Tensor:
        """(N, A) scaled actions of all steps of these episodes that a window can hold."""
        held = torch.unique(self._starts[:, None] + self._steps)
        return self._actions[held]

    def indices(self, size: int, generator: torch.Generator) -> tuple[Tensor, Tensor, Tensor]:
        """Draw `size` windows with replacement.

        Returns:
            First steps of the windows and of their goals, and the last steps of their episodes, each (size,).
        """
        device, window, final_goals = self._starts.device, self.config.window, self.config.final_goals
        chosen = torch.randint(len(self), (size,), generator=generator, device=device)
        start, last_step = self._starts[chosen], self._last_steps[chosen]
        earliest, last = start + window, self._last_goals[chosen]
        uniform = torch.rand(size, generator=generator, device=device, dtype=torch.float64)
        rest = (uniform - final_goals) / (1 - final_goals)  # again uniform in [0, 1), where not negative
        goal = earliest + (rest * (last - earliest + 1)).long()
        return start, torch.where(rest < 0, last, goal), last_step

    def sample(self, size: int, generator: torch.Generator) -> Batch:
        """A batch of random windows with random later goals."""
        start, goal, last_step = self.indices(size, generator)
        steps = start[:, None] + self._steps
        future = torch.minimum(start[:, None] + self._future_steps, last_step[:, None])
        observations, goals = self._observations[steps], self._goals[goal[:, None] + self._goal_steps]
        return Batch(
            observations,
            self._actions[steps],
            self._scaling.seen_goals(goals, observations) if self._scaling else goals,
            self._observations[future],
            goal - (start + self.config.window - 1),
        )
