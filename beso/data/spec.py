"""What a policy needs to know of an environment: sizes, visible dimensions, masked goal dimensions.

Pure data, so that training runs where no simulator is installed.
"""

from dataclasses import dataclass
from typing import NamedTuple

from beso.errors import UserError


class Sizes(NamedTuple):
    """What a network must know: widths of states and actions, number of states in a goal."""

    observation: int
    action: int
    goal_window: int


@dataclass(frozen=True)
class PlaySpec:
    """Shape of an environment's play data and of what policies see of it.

    Attributes:
        name: the environment's name in params.yaml.
        observation_size, action_size: widths of the recorded arrays.
        visible: observation dimensions that policies see, for states and goals alike.
        goal_masked: positions within `visible` that are zeroed (after scaling) in every goal.
        goal_window: number of consecutive states in a goal.
        tasks: names of the tasks whose first completion is labelled in the data.
        longest: the largest number of steps in an episode; one that succeeds is shorter.
    """

    name: str
    observation_size: int
    action_size: int
    visible: tuple[int, ...]
    goal_masked: tuple[int, ...]
    goal_window: int
    tasks: tuple[str, ...]
    longest: int

    @property
    def sizes(self) -> Sizes:
        """Sizes of what policies see."""
        return Sizes(len(self.visible), self.action_size, self.goal_window)


SPECS = {
    "block_push": PlaySpec(
        name="block_push",
        observation_size=16,
        action_size=2,
        visible=tuple(range(10)),  # the poses of the targets are hidden: only the goal tells where the blocks belong
        goal_masked=(2, 5, 6, 7, 8, 9),  # a goal is the places of the two blocks, not their yaw nor the robot
        goal_window=1,
        tasks=("block 1 to target 1", "block 1 to target 2", "block 2 to target 1", "block 2 to target 2"),
        longest=201,
    )
}


def spec(name: str) -> PlaySpec:
    """The specification of one environment.

    Raises:
        UserError: no such environment.
    """
    if name not in SPECS:
        raise UserError(f"environment {name!r} is not one of {', '.join(SPECS)}")
    return SPECS[name]
