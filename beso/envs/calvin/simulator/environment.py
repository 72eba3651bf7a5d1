"""The CALVIN environment for policies: static camera in, relative Cartesian actions out.

The environment of the paper's CALVIN experiments (Mees et al. 2022), written anew: control, physics, joints, state
vectors, camera and start distribution are CALVIN's, the looks are our own (flat colours), unless a folder with
CALVIN's files is given.
"""

from pathlib import Path
from typing import Any

import cv2
import gymnasium
import numpy as np

from beso.checks import not_copied, numbers
from beso.envs.calvin.simulator import tasks
from beso.envs.calvin.simulator.observations import ACTION_SIZE, DRAWER
from beso.envs.calvin.simulator.play_table import CONTROL_HZ, PlayTable
from beso.envs.calvin.simulator.spawn import CLOSED_FIXTURES, OPEN_DRAWER, draw_scene
from beso.envs.calvin.simulator.state import TableState


class CalvinEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """Gymnasium environment `beso/Calvin-v0`; `gymnasium.make` knows the name once beso.envs is imported.

    Args:
        render_mode: None, or "rgb_array" for pictures from `render()`.
        size: height and width of observations, pixels, unless `reset` is given a goal of another size.
        render_size: height and width of rendered pictures, pixels.
        assets: folder with CALVIN's own files, or None for ours.

    Observations are (size, size, 3) uint8 RGB. Actions are (7,): xyz, euler xyz, gripper (> 0 opens), in [-1, 1].

    `info` holds "robot_obs" (15,) and "scene_obs" (24,), see `beso.envs.calvin.simulator.observations`, "state", a
    TableState, and "tasks", the wanted tasks that were done so far (numbers, in the order in which they came to be
    done). A task is done when it is reported between the first state and the one now (simulator.tasks). The episode
    ends with a reward of 1 when all wanted tasks are reported at the same time, which is published evaluation's
    success; nothing else is rewarded.

    Raises:
        ValueError: an unknown render_mode.
        UserError: a file is missing in `assets`.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": CONTROL_HZ}  # noqa: RUF012 (as gymnasium has it)
    __reduce_ex__ = not_copied

    def __init__(
        self, render_mode: str | None = None, size: int = 112, render_size: int = 240, assets: Path | None = None
    ) -> None:
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode {render_mode!r} is not one of None, 'rgb_array'")
        self.render_mode, self.size, self.render_size = render_mode, size, render_size
        self.observation_space = gymnasium.spaces.Box(0, 255, (size, size, 3), dtype=np.uint8)
        self.action_space = gymnasium.spaces.Box(-1, 1, (ACTION_SIZE,), dtype=np.float32)
        self.table = PlayTable(assets)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode.

        `options` may give "scene_obs" (24,), else everything is closed and off and the blocks' places are drawn;
        "robot_obs" (15,), else the arm starts at its neutral pose; "tasks" (34,), 1 for the wanted ones, else there are
        none; "goal" (1, size, size, 3), which `info` then returns. Observations are as large as the goal. Without
        options, the drawer is to be opened: `info["goal"]` is a picture of the start with an open drawer.

        Raises:
            UserError: one of these has another shape, or a number that is not finite.
        """
        super().reset(seed=seed)
        own_goal, options = not options, dict(options or {})
        if "goal" in options:
            options["goal"] = numbers("goal", options["goal"], (None, None, None, 3))
        options["tasks"] = numbers("tasks", options.get("tasks", np.zeros(len(tasks.NAMES))), (len(tasks.NAMES),))
        scene_obs = options.get("scene_obs")
        if scene_obs is None:
            scene_obs = draw_scene(self.np_random, CLOSED_FIXTURES)
        if own_goal:
            options["tasks"][tasks.NAMES.index("open_drawer")] = 1
            opened = scene_obs.copy()
            opened[DRAWER] = OPEN_DRAWER
            self.table.reset(opened)
            options["goal"] = self.table.picture(self.size)[None]
        self.table.reset(scene_obs, options.get("robot_obs"))
        goal = {"goal": options["goal"]} if "goal" in options else {}
        self._goal: np.ndarray | None = options["goal"][-1] if goal else None
        self._shown = self.size if self._goal is None else len(self._goal)
        self._start = self.table.state()
        self._wanted = options["tasks"].astype(bool)
        self._done: list[int] = []
        return self._see(), {**self._info(self._start), **goal}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Carry out a relative action for 1/30 s. Raises UserError if it is not 7 finite numbers."""
        self.table.step(action)
        state = self.table.state()
        reported = self._wanted & tasks.completed(self._start, state)
        self._done += [int(task) for task in np.flatnonzero(reported) if task not in self._done]
        success = bool(self._wanted.any() and reported.sum() == self._wanted.sum())
        return self._see(), float(success), success, False, self._info(state)

    def _see(self) -> np.ndarray:
        """What a policy sees now."""
        return self.table.picture(self._shown)

    def _info(self, state: TableState) -> dict[str, Any]:
        return {
            "robot_obs": self.table.robot_obs(),
            "scene_obs": self.table.scene_obs(),
            "state": state,
            "tasks": tuple(self._done),
        }

    def render(self) -> np.ndarray | None:
        """What the static camera sees, uint8 RGB (render_size, render_size, 3); None without a render_mode.

        In an episode with a goal, the goal image stands left of it: (render_size, 2 * render_size, 3).
        """
        if self.render_mode is None:
            return None
        now = self.table.picture(self.render_size)
        if self._goal is None:
            return now
        goal = cv2.resize(self._goal, now.shape[:2], interpolation=cv2.INTER_CUBIC)
        for picture, title in ((goal, "goal"), (now, "now")):
            cv2.putText(picture, title, (6, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 0), 1, cv2.LINE_AA)
        return np.concatenate([goal, now], axis=1)

    def close(self) -> None:
        """Disconnect from the physics server."""
        self.table.close()
