"""The CALVIN environment for policies: static camera in, relative Cartesian actions out.

The environment of the paper's CALVIN experiments (Mees et al. 2022), written anew: control, physics, joints, state
vectors, camera and start distribution are CALVIN's, the looks are our own (flat colours), unless a folder with
CALVIN's files is given. There is no reward and no termination: tasks are judged from `info["state"]`, see
`beso.envs.calvin.simulator.tasks`.
"""

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from beso.envs.calvin.simulator.observations import ACTION_SIZE
from beso.envs.calvin.simulator.play_table import CONTROL_HZ, PlayTable
from beso.envs.calvin.simulator.spawn import CLOSED_FIXTURES, draw_scene


class CalvinEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """Gymnasium environment `beso/Calvin-v0`.

    Args:
        render_mode: None, or "rgb_array" for pictures of `render_size` pixels from `render()`.
        size: height and width of observations, pixels.
        render_size: height and width of rendered pictures, pixels.
        assets: folder with CALVIN's own files, or None for ours.

    Observations are (size, size, 3) uint8 RGB. Actions are (7,): xyz, euler xyz, gripper (> 0 opens), in [-1, 1].

    `info` holds "robot_obs" (15,) and "scene_obs" (24,), see `beso.envs.calvin.simulator.observations`, and "state", a
    TableState.

    Raises:
        ValueError: an unknown render_mode.
        UserError: a file is missing in `assets`.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": CONTROL_HZ}  # noqa: RUF012 (as gymnasium has it)

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
        "robot_obs" (15,), else the arm starts at its neutral pose; "goal", which `info` then returns.
        """
        super().reset(seed=seed)
        options = options or {}
        scene_obs = options.get("scene_obs")
        if scene_obs is None:
            scene_obs = draw_scene(self.np_random, CLOSED_FIXTURES)
        self.table.reset(scene_obs, options.get("robot_obs"))
        goal = {"goal": options["goal"]} if "goal" in options else {}
        return self.table.picture(self.size), {**self._info(), **goal}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Carry out a relative action for 1/30 s. The reward is 0 and the episode goes on."""
        self.table.step(action)
        return self.table.picture(self.size), 0.0, False, False, self._info()

    def _info(self) -> dict[str, Any]:
        return {
            "robot_obs": self.table.robot_obs(),
            "scene_obs": self.table.scene_obs(),
            "state": self.table.state(),
        }

    def render(self) -> np.ndarray | None:
        """What the static camera sees, (render_size, render_size, 3) uint8 RGB; None without a render_mode."""
        return self.table.picture(self.render_size) if self.render_mode else None

    def close(self) -> None:
        """Disconnect from the physics server."""
        self.table.close()
