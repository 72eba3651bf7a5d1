"""Scaling of what goes into a policy and what comes out of it.

Observations and goals are z-scored per dimension; actions are mapped to [-1, 1] by their range (paper, appendix
"Normalization"). Statistics come from the training episodes alone. Features of an encoder that is trained with the
policy have none; they come scaled (beso.encoders.finetuned).

Policies get goals as they are, or relative to the state: what is still to change.
"""

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from beso.config import require
from beso.data.play import PlayDataset
from beso.data.spec import PlaySpec

CLIP = 1.1  # predicted actions may leave the data's range by a tenth (published code)


@dataclass(frozen=True)
class Scaling:
    """Statistics of the visible observation dimensions and of the actions, as plain numbers."""

    visible: tuple[int, ...]
    goal_masked: tuple[int, ...]
    mean: tuple[float, ...]
    std: tuple[float, ...]
    action_low: tuple[float, ...]
    action_high: tuple[float, ...]
    observation_size: int | None = None  # of raw observations; models of earlier versions do not tell
    relative_goals: bool = False

    def __post_init__(self) -> None:
        visible, width = self.visible, self.observation_size
        require(len(self.mean) == len(self.std) == len(visible) > 0, "visible, mean and std must have equal lengths")
        require(len(self.action_low) == len(self.action_high) > 0, "action_low and action_high must have equal lengths")
        require(min(visible) >= 0 and max(visible) < (width or math.inf), "visible must be columns of observations")
        require(all(0 <= i < len(visible) for i in self.goal_masked), "goal_masked must be positions within visible")
        require(all(value > 0 for value in self.std), "std must be above 0")
        bounds = zip(self.action_low, self.action_high, strict=True)
        require(all(low < high for low, high in bounds), "action_low must be below action_high")

    @classmethod
    def fit(cls, dataset: PlayDataset, episodes: np.ndarray, spec: PlaySpec, relative_goals: bool = False) -> "Scaling":
        """Statistics over all steps of `episodes`."""
        chosen = np.zeros(len(dataset), dtype=bool)
        chosen[episodes] = True
        steps = np.repeat(chosen, dataset.lengths)
        actions = dataset.actions[steps].astype(np.float64)
        mean, std = np.zeros(len(spec.visible)), np.ones(len(spec.visible))
        if dataset.frame_size is None:
            observations = dataset.observations[steps][:, spec.visible].astype(np.float64)
            mean, std = observations.mean(axis=0), observations.std(axis=0)
        span = actions.max(axis=0) - actions.min(axis=0)
        return cls(
            visible=spec.visible,
            goal_masked=spec.goal_masked,
            mean=tuple(mean.tolist()),
            std=tuple(np.where(std > 0, std, 1.0).tolist()),
            action_low=tuple(actions.min(axis=0).tolist()),
            action_high=tuple((actions.min(axis=0) + np.where(span > 0, span, 1.0)).tolist()),
            observation_size=spec.observation_size,
            relative_goals=relative_goals,
        )

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {key: list(value) if isinstance(value, tuple) else value for key, value in asdict(self).items()}

    def scale_observations(self, raw: Tensor) -> Tensor:
        """(..., observation_size) raw -> (..., visible) z-scored."""
        return (raw[..., list(self.visible)] - raw.new_tensor(self.mean)) / raw.new_tensor(self.std)

    def scale_goals(self, raw: Tensor) -> Tensor:
        """(..., observation_size) raw states -> (..., visible) z-scored goals, masked dimensions zero."""
        return self.mask_goals(self.scale_observations(raw))

    def mask_goals(self, scaled: Tensor) -> Tensor:
        """Zero the masked dimensions of scaled states."""
        keep = torch.ones(len(self.visible), dtype=scaled.dtype, device=scaled.device)
        keep[list(self.goal_masked)] = 0
        return scaled * keep

    def seen_goals(self, goals: Tensor, states: Tensor) -> Tensor:
        """Scaled goals (B, G, visible) as policies get them: relative to the first of (B, T, visible), if they are."""
        return self.mask_goals(goals - states[:, :1]) if self.relative_goals else goals

    def scale_actions(self, raw: Tensor) -> Tensor:
        """(..., action_size) raw -> [-1, 1]."""
        low, high = raw.new_tensor(self.action_low), raw.new_tensor(self.action_high)
        return 2 * (raw - low) / (high - low) - 1

    def raw_actions(self, scaled: Tensor) -> Tensor:
        """(..., action_size) scaled actions -> raw."""
        low, high = scaled.new_tensor(self.action_low), scaled.new_tensor(self.action_high)
        return low + (scaled + 1) / 2 * (high - low)
