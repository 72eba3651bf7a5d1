"""What features of CALVIN's frames should tell: fixtures, lights, blocks and the hand."""

from typing import Final

from beso.envs.calvin.simulator import observations as obs
from beso.envs.calvin.simulator.table import DRAWER_TRAVEL, SLIDE_TRAVEL
from beso.images.probe import Target

SCENE: Final = obs.ROBOT_SIZE  # where scene_obs starts in packed states
MARGIN: Final = 0.04  # m; player leaves drawer and door half open now and then


def _block(number: int) -> tuple[int, ...]:
    start = SCENE + obs.block_slice(number).start
    return (start, start + 1, start + 2)


TARGETS: Final = (
    Target("drawer", (SCENE + obs.DRAWER,), DRAWER_TRAVEL / 2, MARGIN),
    Target("slider", (SCENE + obs.SLIDE,), SLIDE_TRAVEL / 2, MARGIN),
    Target("led", (SCENE + obs.LED,), 0.5),
    Target("lightbulb", (SCENE + obs.LIGHTBULB,), 0.5),
    *(Target(name, _block(number)) for number, name in enumerate(obs.BLOCKS)),
    Target("hand", (0, 1, 2)),
    Target("gripper", (obs.GRIPPER_WIDTH,)),
)
