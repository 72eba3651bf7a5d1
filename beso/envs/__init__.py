"""Simulated environments, registered with gymnasium when this package is imported.

Beside its environment class, each module defines how policies are evaluated in it:

    MAX_ACTIONS                                  length of an episode
    make(render_mode)                            an environment
    evaluation_goal(states, observation)         the goal for an episode that starts with `observation`
    result(info, goal_tasks)                     the share of the goal that was reached
    goal_distance(observation, goal)             how far from the goal an episode ended
"""

import importlib
from typing import Any

import gymnasium

from beso.data.spec import spec

gymnasium.register("beso/BlockPush-v0", entry_point="beso.envs.block_push:BlockPushEnv")


def load(name: str) -> Any:
    """The module of one environment.

    Raises:
        UserError: no such environment.
    """
    return importlib.import_module(f"beso.envs.{spec(name).name}")
