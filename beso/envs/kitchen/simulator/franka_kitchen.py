"""gymnasium-robotics' kitchen as it is, cheap to have many of in one process."""

import contextlib
import copy
import functools
import io
from typing import Any

import mujoco

with contextlib.redirect_stderr(io.StringIO()):  # it announces changes to environments that are not used here
    from gymnasium_robotics.envs.franka_kitchen.franka_env import FrankaRobot
    from gymnasium_robotics.envs.franka_kitchen.kitchen_env import KitchenEnv as FrankaKitchen

ROBOT_NOISE_RATIO = 0.1  # times the configured amplitude, 0.1, this is the relay environment's 0.01
OWN = ("robot_env", "model", "data", "mujoco_renderer", "_np_random", "_np_random_seed")


def franka_kitchen() -> Any:
    """A FrankaKitchen-v1 with all seven tasks, which goes on after the last one.

    The robot has the relay environment's observation noise; the objects have none (see KitchenEnv).

    Compiling the kitchen's meshes costs some tenths of a second and 60 MB, so that the kitchens of a process share one
    compiled model, which nothing writes to. Each has a simulation state and a random generator of its own.
    """
    first = _compiled_kitchen()
    kitchen, robot = _twin(first), _twin(first.robot_env)
    kitchen.robot_env = robot
    kitchen.model = robot.model = first.model
    kitchen.data = robot.data = mujoco.MjData(first.model)
    robot.mujoco_renderer = None  # pictures are made by Camera
    return kitchen


@functools.cache
def _compiled_kitchen() -> Any:
    """The kitchen whose parts the others of this process take; it is never played."""
    return FrankaKitchen(
        terminate_on_tasks_completed=False, object_noise_ratio=0.0, robot_noise_ratio=ROBOT_NOISE_RATIO
    )


def _twin(env: FrankaKitchen | FrankaRobot) -> Any:
    """An environment with the same settings. copy.copy would build, and so compile, a new one."""
    twin = object.__new__(type(env))
    vars(twin).update({name: copy.copy(value) for name, value in vars(env).items() if name not in OWN})
    twin._np_random = None  # gymnasium makes one at the first reset
    return twin
