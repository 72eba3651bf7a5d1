"""What is evaluated: goal sets, numbers of episodes, and their division into fixed chunks."""

from dataclasses import dataclass
from typing import Literal

from beso.config import require, require_positive

GoalSet = Literal["training", "held_out"]


@dataclass(frozen=True)
class EvaluationConfig:
    """How policies are evaluated.

    Attributes:
        seed: root of starts and policy noise, apart from the training seed.
        rollouts: episodes a model seed and goal set.
        goals: "training" takes goals from training demonstrations, as the paper does, "held_out" from the others.
        chunk: environments stepped together.
        max_actions: longest episode, or null for the environment's own limit.
        video: whether the first episode is filmed.
    """

    seed: int
    rollouts: int
    goals: tuple[GoalSet, ...]
    chunk: int
    max_actions: int | None
    video: bool

    def __post_init__(self) -> None:
        require(self.seed >= 0, f"seed = {self.seed}: must not be negative")
        require_positive(self, "rollouts", "chunk")
        require(
            self.goals in (("training",), ("training", "held_out")),
            f"goals = {list(self.goals)}: must be [training] or [training, held_out]",
        )
        require(self.max_actions is None or self.max_actions >= 1, f"max_actions = {self.max_actions}: must be above 0")


@dataclass(frozen=True)
class Chunk:
    """Episodes [first, last) of one model seed and goal set."""

    goals: GoalSet
    first: int
    last: int


def chunks(config: EvaluationConfig) -> list[Chunk]:
    """All chunks of one model seed, in order."""
    starts = range(0, config.rollouts, config.chunk)
    return [Chunk(goals, i, min(i + config.chunk, config.rollouts)) for goals in config.goals for i in starts]
