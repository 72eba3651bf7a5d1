"""What shapes a training run: optimisation, held-out measurements, and the run as a whole."""

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from beso.config import require, require_positive, require_rate
from beso.core.device import PrecisionOrAuto
from beso.data.split import model_split

STEP_DECAY_EVERY, STEP_DECAY = 100, 0.99  # the published code's StepLR


@dataclass(frozen=True)
class OptimizationConfig:
    """How a method is optimised.

    Attributes:
        steps, batch_size: number of updates and samples an update.
        optimizer: "adam", "adamw" or "muon" (see beso.training.optimizers).
        learning_rate, weight_decay: for all parameters.
        schedule: "constant", "cosine" (to 0 at the last step) or "step" (times 0.99 every 100 steps).
        ema_decay: of the averaged weights, which are the ones saved; 0 saves the last weights. At step n the decay is
            min(ema_decay, (1 + n) / (10 + n)).
        precision: "fp32", "bf16" for autocast, or "auto" for what the device is fast at.
    """

    steps: int
    batch_size: int
    optimizer: Literal["adam", "adamw", "muon"]
    learning_rate: float
    weight_decay: float
    schedule: Literal["constant", "cosine", "step"]
    ema_decay: float
    precision: PrecisionOrAuto

    def __post_init__(self) -> None:
        require_positive(self, "steps", "batch_size")
        require(self.learning_rate > 0, f"learning_rate = {self.learning_rate}: must be above 0")
        require(self.weight_decay >= 0, f"weight_decay = {self.weight_decay}: must not be negative")
        require_rate(self, "ema_decay")

    def learning_rate_at(self, step: int) -> float:
        """The learning rate of update `step`, counted from 0."""
        if self.schedule == "cosine":
            return self.learning_rate * (1 + math.cos(math.pi * step / self.steps)) / 2
        if self.schedule == "step":
            return self.learning_rate * STEP_DECAY ** (step // STEP_DECAY_EVERY)
        return self.learning_rate


@dataclass(frozen=True)
class ValidationConfig:
    """Held-out measurements during training.

    Attributes:
        every: steps between two measurements; there is always one after the last step.
        windows: number of held-out windows measured, the same ones every time.
    """

    every: int
    windows: int

    def __post_init__(self) -> None:
        require_positive(self, "every", "windows")


@dataclass(frozen=True)
class TrainingConfig:
    """Everything that shapes one method's trained weights on one environment, besides data and seed."""

    model: Any
    optimization: OptimizationConfig


@dataclass(frozen=True)
class TrainingJob:
    """One training run.

    Attributes:
        method: name of the method's module.
        config: its configuration.
        validation: held-out measurements.
        train_fraction: share of the episodes used for training.
        goal_horizon: the largest number of steps from a window to its goal; None is the rest of the episode.
        relative_goals: policies get goals less the first state of their context.
        root_seed, seed: the project's seed and this model's number.
    """

    method: str
    config: TrainingConfig
    validation: ValidationConfig
    train_fraction: float
    goal_horizon: int | None
    relative_goals: bool
    root_seed: int
    seed: int

    def split(self, episodes: int) -> tuple[np.ndarray, np.ndarray]:
        """Training and held-out ones of so many episodes, indices."""
        return model_split(episodes, self.train_fraction, self.root_seed, self.seed)
