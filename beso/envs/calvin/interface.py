"""What the numbers of CALVIN are, in words."""

from beso.envs.calvin.spec import FEATURES
from beso.interface import Columns, Interface

INTERFACE = Interface(
    observation=(
        Columns(FEATURES, "features of the static camera's picture, by the encoder beside the run's play data", ""),
    ),
    action=(
        Columns(3, "shift of the gripper, x, y and z, in [-1, 1]", "0.02 m"),
        Columns(3, "turn of the gripper, Euler angles x, y and z, in [-1, 1]", "0.05 rad"),
        Columns(1, "gripper, above 0 opens, else it closes", ""),
    ),
    goal="an observation of the table as it should be",
    period=1 / 30,
)
