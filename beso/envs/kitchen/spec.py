"""The relay kitchen: sizes, what policies see, and its seven tasks: where they are read off and when they are done.

The tasks' numbers are those of gymnasium-robotics' FrankaKitchen-v1 and of Gupta et al.'s relay environment (2019).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from beso.data.spec import PlaySpec

ROBOT, OBJECTS = slice(0, 9), slice(18, 39)  # in observations of FrankaKitchen-v1; the rest are velocities
THRESHOLD = 0.3  # rad or m, the Euclidean distance of an element from its goal below which its task is done


@dataclass(frozen=True)
class Task:
    """One task.

    Attributes:
        name: as the environment and the paper call it.
        letter: short name in sets of tasks.
        element: indices into an observation (or the simulator's qpos) of the element that it moves.
        goal: where the element should be: radians, metres, and for the kettle a position and a quaternion (w first).
    """

    name: str
    letter: str
    element: tuple[int, ...]
    goal: tuple[float, ...]


TASKS = (  # in the order in which people did them (the executed orders of the relay demonstrations)
    Task("microwave", "m", (22,), (-0.75,)),
    Task("kettle", "k", (23, 24, 25, 26, 27, 28, 29), (-0.23, 0.75, 1.62, 0.99, 0.0, 0.0, -0.06)),
    Task("bottom burner", "b", (11, 12), (-0.88, -0.01)),
    Task("top burner", "t", (15, 16), (-0.92, -0.01)),
    Task("light switch", "l", (17, 18), (-0.69, -0.05)),
    Task("slide cabinet", "s", (19,), (0.37,)),
    Task("hinge cabinet", "h", (20, 21), (0.0, 1.45)),
)
MICROWAVE, KETTLE, BOTTOM_BURNER, TOP_BURNER, LIGHT_SWITCH, SLIDE_CABINET, HINGE_CABINET = range(len(TASKS))


def done(states: np.ndarray) -> np.ndarray:
    """Which tasks are done in states, (..., 30) -> (..., 7) booleans."""
    distances = [np.linalg.norm(states[..., task.element] - np.array(task.goal), axis=-1) for task in TASKS]
    return np.stack(distances, axis=-1) < THRESHOLD


SPEC = PlaySpec(
    name="kitchen",
    observation_size=30,  # 9 joints of the robot, 21 coordinates of the things in the kitchen
    action_size=9,
    visible=tuple(range(30)),
    goal_masked=(),  # the robot's pose is part of a goal, as in the published code
    goal_window=2,
    tasks=tuple(task.name for task in TASKS),
    goal_sets=("training", "held_out"),
    packages=("numpy", "mujoco", "gymnasium-robotics"),
)


def goal_after(state: np.ndarray, places: Mapping[int, Sequence[float] | np.ndarray]) -> np.ndarray:
    """A goal, (G, 30): a state (30,), but with the elements of some tasks at other places.

    Args:
        places: a place for the element of each task, by the task's number.
    """
    goal = np.array(state)
    for task, place in places.items():
        goal[list(TASKS[task].element)] = place
    return np.tile(goal, (SPEC.goal_window, 1))
