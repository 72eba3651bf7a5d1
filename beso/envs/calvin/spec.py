"""CALVIN: sizes, what policies see, and its 34 tasks.

Policies see what an encoder makes of the static camera's pictures; there is no other observation (paper, "CALVIN
Benchmark").
"""

from beso.data.spec import PlaySpec

FEATURES = 512  # of a ResNet-18
COLOURS = ("red", "blue", "pink")

SPEC = PlaySpec(
    name="calvin",
    observation_size=FEATURES,
    action_size=7,  # relative xyz and euler xyz, gripper
    visible=tuple(range(FEATURES)),
    goal_masked=(),
    goal_window=1,
    tasks=(  # in CALVIN's order
        *(f"rotate_{colour}_block_{way}" for colour in COLOURS for way in ("right", "left")),
        *(f"push_{colour}_block_{way}" for colour in COLOURS for way in ("right", "left")),
        "move_slider_left",
        "move_slider_right",
        "open_drawer",
        "close_drawer",
        *(f"lift_{colour}_block_{place}" for colour in COLOURS for place in ("table", "slider", "drawer")),
        "place_in_slider",
        "place_in_drawer",
        "stack_block",
        "unstack_block",
        "turn_on_lightbulb",
        "turn_off_lightbulb",
        "turn_on_led",
        "turn_off_led",
        "push_into_drawer",
    ),
    goal_sets=("single_tasks", "two_tasks"),
    packages=("numpy", "pybullet", "opencv-python-headless"),
)
# What a single trial can ask for: no goal image may show the arm at its task (paper, "hard"), and a lifted block hangs
# in the gripper.
SINGLE_TASKS = tuple(task for task in SPEC.tasks if not task.startswith("lift_"))
