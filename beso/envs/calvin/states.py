"""CALVIN as its simulator's state: what stands for pictures where play and recipes are judged without them.

Play, tasks and trials are CALVIN's. Policies see 39 numbers: robot_obs and scene_obs.
"""

from dataclasses import replace
from typing import Any, Final

import numpy as np

from beso.data.play import Episode
from beso.envs.calvin import spec, trials
from beso.envs.calvin.demonstrations import scripted
from beso.envs.calvin.simulator import CalvinEnv
from beso.envs.calvin.simulator.play_table import PlayTable
from beso.envs.protocol import Trial, TrialRequest

SIZE: Final = 39
SPEC: Final = replace(spec.SPEC, observation_size=SIZE, visible=tuple(range(SIZE)))
LENGTH: Final = 500  # steps of a stretch of play


def see(table: PlayTable) -> np.ndarray:
    """The state of arm and table, (39,)."""
    return np.concatenate([table.robot_obs(), table.scene_obs()]).astype(np.float32)


def record(seed: int, index: int) -> Episode:
    """A stretch of play."""
    steps = list(scripted.record(seed, index, LENGTH, None))
    return Episode(
        np.array([[*step.robot_obs, *step.scene_obs] for step in steps]),
        np.array([step.rel_action for step in steps]),
        np.array([step.tasks for step in steps]),
    )


def make_trials(request: TrialRequest) -> list[Trial]:
    """The trials asked for; their goals are (1, 39)."""
    table = PlayTable()
    try:
        return [trials.trial(table, request, number, lambda: see(table)) for number in request.numbers]
    finally:
        table.close()


class StatesEnv(CalvinEnv):
    """CALVIN whose observations and goals are states."""

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """As CalvinEnv; the goal is (1, 39)."""
        options = dict(options or {})
        goal = options.pop("goal", None)
        observation, info = super().reset(seed=seed, options=options)
        return observation, {**info, "goal": goal}

    def _see(self) -> np.ndarray:
        return see(self.table)


make = StatesEnv
