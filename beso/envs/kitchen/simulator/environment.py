"""The relay kitchen (Gupta et al. 2019) on gymnasium-robotics' FrankaKitchen-v1.

Observation, 30 numbers, with noise (radians, metres):

    0-6 arm joints      7-8 fingers
    9-16 four knobs and their burners (two numbers each; the bottom burner is 11-12, the top burner 15-16)
    17-18 light switch and its light    19 slide cabinet    20-21 left and right hinge cabinet    22 microwave
    23-29 kettle, position and quaternion (w first)

Action, 9 numbers in [-1, 1]: velocities of arm joints and fingers in units of 2 rad/s (m/s), for one step of 0.08 s.
An action moves the joints from where they were last *observed*, so that the noise acts on the robot too.
"""

from typing import Any

import gymnasium
import mujoco
import numpy as np

from beso.checks import not_copied, numbers
from beso.envs.kitchen import spec
from beso.envs.kitchen.simulator.camera import Camera
from beso.envs.kitchen.simulator.franka_kitchen import ROBOT_NOISE_RATIO, franka_kitchen

# Largest noise of the 21 objects' coordinates: 0.1 times an amplitude. The relay environment's configuration has 35
# amplitudes, and it takes entries 9 to 29 of them. The wrapped environment takes other entries.
AMPLITUDES = (0.005, 0.0005, 0.005, 0.1, 0.005, 0.1, 0.005)
OBJECT_NOISE = 0.1 * np.repeat(AMPLITUDES, (2, 6, 3, 3, 3, 3, 1))
LARGEST = 11.0  # rad or m: the widest bound in the robot's and kitchen's configuration is 10.57
GOAL_TASKS = (spec.MICROWAVE, spec.KETTLE, spec.LIGHT_SWITCH, spec.SLIDE_CABINET)  # of D4RL's kitchen-complete


class KitchenEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """Gymnasium environment `beso/Kitchen-v0`; `gymnasium.make` knows the name once beso.envs is imported.

    Every episode starts in the same state; the seed fixes the noise. The reward is 1 for each of the seven tasks that
    is done for the first time in an episode, and the episode ends when all are done.

    `info["tasks"]` is the tuple of tasks done so far (indices into spec.TASKS) in order. `info["goal"]` after a reset
    is a goal for a policy, (G, 30) states: what `options["goal"]` gave, else the first observation twice, but with
    microwave, kettle, light switch and slide cabinet done. Goals of demonstrations have another pose of the robot.

    Args:
        render_mode: None, or "rgb_array" for pictures of `render_size` pixels.
        render_size: (height, width) of rendered pictures.
        noise: factor of the observations' noise. 1 in play data and evaluation, 0 for none.

    Raises:
        ValueError: an unknown render_mode, or a noise that is negative or not finite.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 12}  # noqa: RUF012 (as gymnasium has it)
    __reduce_ex__ = not_copied

    def __init__(
        self, render_mode: str | None = None, render_size: tuple[int, int] = (240, 320), noise: float = 1.0
    ) -> None:
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode {render_mode!r} is not one of None, 'rgb_array'")
        if not 0 <= noise < np.inf:
            raise ValueError(f"noise {noise!r} is not a number from 0 up")
        self.render_mode, self.render_size, self.noise = render_mode, render_size, noise
        self.observation_space = gymnasium.spaces.Box(-LARGEST, LARGEST, shape=(30,), dtype=np.float64)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, shape=(9,), dtype=np.float32)
        self._kitchen = franka_kitchen()
        self._kitchen.robot_env.robot_noise_ratio = noise * ROBOT_NOISE_RATIO
        self._tasks: list[int] = []
        self._camera: Camera | None = None

    @property
    def model(self) -> mujoco.MjModel:
        """The compiled scene, shared by all kitchens of the process: not to be written to."""
        return self._kitchen.model

    @property
    def data(self) -> mujoco.MjData:
        """The simulation's state."""
        return self._kitchen.data

    def done(self) -> np.ndarray:
        """Which tasks are done now, noise aside, (7,) booleans."""
        return spec.done(self.data.qpos)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode. With a seed it depends on nothing that was played before."""
        super().reset(seed=seed)
        # The wrapped environment draws the robot's noise from a stream of its own.
        observation, _ = self._kitchen.reset(seed=int(self.np_random.integers(2**31)))
        self._tasks = []
        state = self._state(observation)
        if options and "goal" in options:
            goal = np.array(numbers("goal", options["goal"], (None, 30)))
        else:
            goal = spec.goal_after(state, {task: spec.TASKS[task].goal for task in GOAL_TASKS})
        return state, {"tasks": (), "goal": goal}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Move the joints with velocities `action`, (9,) in units of 2 rad/s, for 0.08 s."""
        observation, _, _, _, _ = self._kitchen.step(numbers("action", action, (9,)).astype(np.float64))
        # Read off here: what the wrapped environment reports is ordered by the hashes of names, which change between
        # processes.
        new = [int(task) for task in np.flatnonzero(self.done()) if task not in self._tasks]
        self._tasks += new
        all_done = len(self._tasks) == len(spec.TASKS)
        return self._state(observation), float(len(new)), all_done, False, {"tasks": tuple(self._tasks)}

    def _state(self, observation: dict[str, Any]) -> np.ndarray:
        """The relay environment's 30 numbers of the wrapped environment's 59."""
        robot, objects = observation["observation"][spec.ROBOT], observation["observation"][spec.OBJECTS]
        noise = self.noise * OBJECT_NOISE * self.np_random.uniform(-1, 1, len(OBJECT_NOISE))
        return np.concatenate([robot, objects + noise])

    def render(self) -> np.ndarray | None:
        """A picture of the scene, (height, width, 3) uint8 RGB.

        Raises:
            CannotDrawError: MuJoCo cannot draw on this machine.
        """
        if self.render_mode is None:
            return None
        self._camera = self._camera or Camera(self.model, self.render_size)
        return self._camera.picture(self.data)

    def close(self) -> None:
        """Free the camera."""
        if self._camera:
            self._camera.close()
            self._camera = None
