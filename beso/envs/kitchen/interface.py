"""What the numbers of the kitchen are, in words; the simulator's docstring has the same."""

from beso.interface import Columns, Interface

INTERFACE = Interface(
    observation=(
        Columns(7, "arm joints", "rad"),
        Columns(2, "fingers", "m"),
        Columns(2, "knob and place of the bottom right burner", "rad, m"),
        Columns(2, "knob and place of the bottom burner (the left one)", "rad, m"),
        Columns(2, "knob and place of the top right burner", "rad, m"),
        Columns(2, "knob and place of the top burner (the left one)", "rad, m"),
        Columns(2, "light switch and place of its light", "rad, m"),
        Columns(1, "slide cabinet", "m"),
        Columns(2, "left and right hinge cabinet", "rad"),
        Columns(1, "microwave", "rad"),
        Columns(3, "kettle, position", "m"),
        Columns(4, "kettle, quaternion (w first)", ""),
    ),
    action=(
        Columns(7, "velocities of the arm joints, in [-1, 1]", "2 rad/s"),
        Columns(2, "velocities of the fingers, in [-1, 1]", "2 m/s"),
    ),
    goal="two consecutive observations, the earlier first, with all as it should be, the robot's pose too",
    period=0.08,
)
