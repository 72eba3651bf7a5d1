"""What the numbers of block push are, in words; the simulator's docstring has the same."""

from beso.interface import Columns, Interface

INTERFACE = Interface(
    observation=(
        Columns(2, "block 1, x and y", "m"),
        Columns(1, "block 1, yaw", "rad"),
        Columns(2, "block 2, x and y", "m"),
        Columns(1, "block 2, yaw", "rad"),
        Columns(2, "effector, x and y", "m"),
        Columns(2, "effector's target, x and y", "m"),
        Columns(2, "target 1, x and y", "m"),
        Columns(1, "target 1, yaw", "rad"),
        Columns(2, "target 2, x and y", "m"),
        Columns(1, "target 2, yaw", "rad"),
    ),
    action=(Columns(2, "shift of the effector's target, x and y", "m"),),
    goal="an observation with the two blocks where they should come to lie",
    period=0.1,
)
