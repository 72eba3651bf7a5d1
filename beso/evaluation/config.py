"""What is evaluated: goal sets, numbers of episodes, and their division into fixed chunks."""

from dataclasses import dataclass

from beso.config import require, require_positive


@dataclass(frozen=True)
class EvaluationConfig:
    """How policies are evaluated.

    Attributes:
        seed: root of starts and policy noise, apart from the training seed.
        rollouts: episodes a model seed and goal set.
        goals: some of the environment's goal sets, the paper's first.
        chunk: environments stepped together.
        max_actions: longest episode, or null for the environment's own limit.
        tasks: what trials for single tasks ask for in turn, where the environment's spec says what they may be.
    """

    seed: int
    rollouts: int
    goals: tuple[str, ...]
    chunk: int
    max_actions: int | None
    tasks: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        require(self.seed >= 0, f"seed = {self.seed}: must not be negative")
        require_positive(self, "rollouts", "chunk")
        require(
            len(set(self.goals)) == len(self.goals) > 0, f"goals = {list(self.goals)}: must be different, at least one"
        )
        require(self.max_actions is None or self.max_actions >= 1, f"max_actions = {self.max_actions}: must be above 0")
        tasks = self.tasks
        require(
            tasks is None or len(set(tasks)) == len(tasks) > 0,
            f"tasks = {list(tasks or ())}: must be different, at least one",
        )


@dataclass(frozen=True)
class Chunk:
    """Episodes [first, last) of one model seed and goal set."""

    goals: str
    first: int
    last: int


def chunks(config: EvaluationConfig) -> list[Chunk]:
    """All chunks of one model seed, in order."""
    starts = range(0, config.rollouts, config.chunk)
    return [Chunk(goals, i, min(i + config.chunk, config.rollouts)) for goals in config.goals for i in starts]
