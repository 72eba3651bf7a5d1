"""gymnasium-robotics' own FrankaKitchen-v1 as the kitchen's policies see it.

    kitchen = gymnasium.make("FrankaKitchen-v1", tasks_to_complete=["microwave", "kettle"])
    told, _ = kitchen.reset(seed=0)
    policy.reset(franka.goal(told))
    told, *_ = kitchen.step(policy.act(franka.observation(told)))      # in a loop

Its actions are the policies'. Its noise is not that of the play data and of evaluation, which beso/Kitchen-v0 has.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from beso.checks import numbers
from beso.envs.kitchen.demonstrations.published import FRANKA_KITCHEN_WIDTH
from beso.envs.kitchen.spec import OBJECTS, ROBOT, SPEC, TASKS, goal_after
from beso.errors import UserError


def observation(told: Mapping[str, Any]) -> np.ndarray:
    """A policy's observation (30,) from an observation of FrankaKitchen-v1, a dictionary; velocities are left out.

    Raises:
        UserError: it is no such dictionary.
    """
    state = numbers("FrankaKitchen-v1's observation", _entry(told, "observation"), (FRANKA_KITCHEN_WIDTH,))
    return np.concatenate([state[ROBOT], state[OBJECTS]])


def goal(told: Mapping[str, Any]) -> np.ndarray:
    """A policy's goal (2, 30) from an observation of FrankaKitchen-v1: the state now, but the wanted tasks done.

    The wanted tasks are the environment's `tasks_to_complete`, the entries of "desired_goal". Goals of demonstrations,
    which policies are trained with, have the robot's pose after its last task; here it stays as it is.

    Raises:
        UserError: it is no such dictionary, or it wants a task that the kitchen does not have.
    """
    state, wanted = observation(told), _entry(told, "desired_goal")
    if not isinstance(wanted, Mapping) or not wanted or not wanted.keys() <= {*SPEC.tasks}:
        raise UserError(f"desired_goal must map some of {', '.join(SPEC.tasks)} to where their elements should be")
    places = {}
    for name, place in wanted.items():
        task = SPEC.tasks.index(name)
        places[task] = numbers(f"desired_goal of {name}", place, (len(TASKS[task].element),))
    return goal_after(state, places)


def _entry(told: Mapping[str, Any], key: str) -> Any:
    if not isinstance(told, Mapping) or key not in told:
        raise UserError(f"expected an observation of FrankaKitchen-v1, a dictionary with {key}")
    return told[key]
