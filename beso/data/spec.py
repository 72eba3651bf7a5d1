"""What a policy needs to know of an environment: sizes, visible dimensions, masked goal dimensions.

Pure data, so that training runs where no simulator is installed.
"""

from dataclasses import dataclass
from typing import NamedTuple


class Sizes(NamedTuple):
    """What a network must know: widths of states and actions, number of states in a goal."""

    observation: int
    action: int
    goal_window: int


@dataclass(frozen=True)
class PlaySpec:
    """Shape of an environment's play data and of what policies see of it.

    Attributes:
        name: the environment's name: its folder in beso/envs, and what params.yaml calls it.
        observation_size, action_size: widths of the recorded arrays.
        visible: observation dimensions that policies see, for states and goals alike.
        goal_masked: positions within `visible` that are zeroed (after scaling) in every goal.
        goal_window: number of consecutive states in a goal.
        tasks: names of the tasks whose first completion is labelled in the data.
        goal_sets: kinds of goals that policies are evaluated on; the first is the paper's protocol.
        packages: those whose versions scripted play data depend on.
    """

    name: str
    observation_size: int
    action_size: int
    visible: tuple[int, ...]
    goal_masked: tuple[int, ...]
    goal_window: int
    tasks: tuple[str, ...]
    goal_sets: tuple[str, ...]
    packages: tuple[str, ...] = ("numpy",)

    @property
    def sizes(self) -> Sizes:
        """Sizes of what policies see."""
        return Sizes(len(self.visible), self.action_size, self.goal_window)
