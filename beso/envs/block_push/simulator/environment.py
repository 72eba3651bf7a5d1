"""Multimodal block pushing: an xArm pushes two blocks into two target zones, in any pairing and order.

The environment of the paper's Block-Push experiments (Florence et al. 2022 in the variant of Cui et al. 2023),
written anew on PyBullet. Physics, control, start distribution, reward and termination follow the published
environment; every draw comes from the environment's own generator, so `reset(seed=...)` fixes an episode.

Observation, 16 numbers (metres, radians):

    0-1 block 1 xy      2 block 1 yaw      3-4 block 2 xy       5 block 2 yaw
    6-7 effector xy     8-9 effector target xy
    10-11 target 1 xy   12 target 1 yaw    13-14 target 2 xy    15 target 2 yaw

Action, 2 numbers: displacement of the effector's target in the plane, metres per step (0.1 s).
"""

import functools
import math
import tempfile
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pybullet
import pybullet_data

from beso.checks import not_copied, numbers
from beso.envs.block_push.simulator.assets import write_assets

CONTROL_HZ, PHYSICS_HZ = 10, 240
SUBSTEPS = PHYSICS_HZ // CONTROL_HZ
SETTLE_STEPS = 100

WORKSPACE_LOW, WORKSPACE_HIGH = np.array([0.15, -0.5]), np.array([0.7, 0.5])
EFFECTOR_HEIGHT = 0.06
EFFECTOR_START = np.array([0.3, -0.4])
TOOL_DOWN = (0.0, 1.0, 0.0, 6.123233995736766e-17)  # quaternion xyzw: half a turn about y
EFFECTOR_LINK = 6
ARM_JOINTS = list(range(1, 7))  # joint 0 is the fixed base
# The arm above EFFECTOR_START with the tool pointing down; set by hand because inverse kinematics has many answers.
HOME_JOINTS = [
    -0.9254632489674508,
    0.6990770671568564,
    -1.106629064060494,
    0.0006653351931553931,
    0.3987969742311386,
    -4.063402065624296,
]
MOTOR_FORCE = 1200.0
TOOL_MOUNT_FORCE = 50.0

BLOCK_CENTRE, BLOCK_SPREAD = np.array([0.4, -0.2]), np.array([0.1, 0.15])
BLOCK_YAW = (1.0, math.pi)
MIN_BLOCK_GAP = 0.1  # between the blocks' x alone
TARGET_CENTRE, TARGET_SPREAD = np.array([0.4, 0.2]), np.array([0.005, 0.0075])
TARGET_OFFSET, TARGET_YAW_SPREAD, TARGET_HEIGHT = 0.12, math.pi / 30, 0.02

OTHER_SIDE = 0.2  # m; a target further away than this from where it was lies on the other side
ENTRY_REWARD, SUCCESS_REWARD = 0.49, 0.51
PAIRS = 4  # pair index = 2 * block + target


class _Client:
    """PyBullet's functions bound to a physics server of their own in this process."""

    def __init__(self) -> None:
        self.identifier = pybullet.connect(pybullet.DIRECT)

    __reduce_ex__ = not_copied

    def __getattr__(self, name: str) -> Any:
        function = functools.partial(getattr(pybullet, name), physicsClientId=self.identifier)
        setattr(self, name, function)
        return function


class BlockPushEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """Gymnasium environment `beso/BlockPush-v0`; `gymnasium.make` knows the name once beso.envs is imported.

    Args:
        render_mode: None, or "rgb_array" for pictures of `render_size` pixels.
        tolerance: distance in metres at which a block's centre counts as inside a target. 0.05 in evaluation;
            the published demonstrations were recorded at 0.04.
        render_size: (height, width) of rendered pictures.

    `info["tasks"]` is the tuple of (block, target) pairs entered so far in order of first entry, as 2 * block + target.
    `info["goal"]` after a reset is a goal for a policy, (G, 16) states: what `options["goal"]` gave, see `reset`, else
    the first observation, but with each block in the target of its number. Observations have no noise.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": CONTROL_HZ}  # noqa: RUF012 (as gymnasium has it)
    __reduce_ex__ = not_copied

    def __init__(
        self, render_mode: str | None = None, tolerance: float = 0.05, render_size: tuple[int, int] = (240, 320)
    ) -> None:
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"render_mode {render_mode!r} is not one of None, 'rgb_array'")
        self.render_mode, self.tolerance, self.render_size = render_mode, tolerance, render_size
        bound = np.array([5, 5, 2 * math.pi] * 2 + [1, 1] * 2 + [5, 5, 2 * math.pi] * 2)
        self.observation_space = gymnasium.spaces.Box(-bound, bound, dtype=np.float64)
        self.action_space = gymnasium.spaces.Box(-0.1, 0.1, shape=(2,), dtype=np.float32)
        self._client = _Client()
        self._pairs: list[int] = []

    def _load_scene(self) -> None:
        """Build the scene anew.

        Restoring a saved state would be cheaper by 20 ms, but PyBullet keeps contact pairs of earlier episodes in an
        order of its own, and about one episode in forty would come out differently.
        """
        client = self._client
        client.resetSimulation()
        client.setGravity(0, 0, -9.8)
        # Shapes that nobody looks at are not loaded; the physics is the same.
        flags = 0 if self.render_mode else pybullet.URDF_IGNORE_VISUAL_SHAPES

        client.setAdditionalSearchPath(pybullet_data.getDataPath())
        client.loadURDF("plane.urdf", basePosition=[0, 0, -0.001], flags=flags)
        with tempfile.TemporaryDirectory() as folder:
            write_assets(Path(folder))

            def load(name: str, **where: Any) -> int:
                return client.loadURDF(f"{folder}/{name}", flags=flags, **where)

            load("workspace.urdf", basePosition=[0.35, 0, 0])
            self._arm = client.loadURDF("xarm/xarm6_robot.urdf", flags=flags)
            for joint, angle in zip(ARM_JOINTS, HOME_JOINTS, strict=True):
                client.changeDynamics(self._arm, joint, linearDamping=0, angularDamping=0)
                client.resetJointState(self._arm, joint, angle)
            position, orientation = client.getLinkState(self._arm, EFFECTOR_LINK)[:2]
            tool = load("tool.urdf", basePosition=position, baseOrientation=orientation)
            self._zones = [load(f"zone{i}.urdf", useFixedBase=True) for i in (1, 2)]
            self._blocks = [load(f"block{i}.urdf") for i in (1, 2)]

        # The constraint pulls the tool into the wrist, and the contact between wrist and tool holds it 1.2 cm lower:
        # at that height the shaft meets the blocks. Without this contact only the thin needle would touch them.
        mount = client.createConstraint(
            self._arm, EFFECTOR_LINK, tool, -1, pybullet.JOINT_FIXED, (0, 0, 0), (0, 0, 0), (0, 0, 0)
        )
        client.changeConstraint(mount, maxForce=TOOL_MOUNT_FORCE)
        self._simulate(SETTLE_STEPS)

    def _simulate(self, steps: int) -> None:
        for _ in range(steps):
            self._client.stepSimulation()

    def _move_effector_target(self, target: np.ndarray) -> None:
        self._effector_target = target
        measured = [state[0] for state in self._client.getJointStates(self._arm, ARM_JOINTS)]
        joints = self._client.calculateInverseKinematics(
            self._arm,
            EFFECTOR_LINK,
            (target[0], target[1], EFFECTOR_HEIGHT),
            TOOL_DOWN,
            lowerLimits=[-17] * 6,
            upperLimits=[17] * 6,
            jointRanges=[17] * 6,
            restPoses=[0, 0, *measured[2:]],
            maxNumIterations=100,
            residualThreshold=1e-10,
        )
        self._client.setJointMotorControlArray(
            self._arm, ARM_JOINTS, pybullet.POSITION_CONTROL, targetPositions=joints, forces=[MOTOR_FORCE] * 6
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode: blocks on the robot's side, the two targets on the other, their sides drawn at random.

        Args:
            options: {"goal": (G, 16) last states of a demonstration} gives `info["goal"]`, the same made to fit this
                episode (see `fitting_goal`).

        Raises:
            UserError: the goal has another shape, or a number that is not finite.
        """
        super().reset(seed=seed)
        goal = numbers("goal", options["goal"], (None, 16)) if options and "goal" in options else None
        rng = self.np_random
        self._load_scene()
        self._move_effector_target(EFFECTOR_START.copy())

        first, second = self._draw_block_places()
        for body, xy in zip(self._blocks, (first, second), strict=True):
            # Height 0 sinks the block into the ground; it surfaces while the scene settles.
            self._place(body, xy, 0.0, rng.uniform(*BLOCK_YAW))

        side = rng.choice([-1, 1])
        self._target_poses = np.empty((2, 3))
        for i, body in enumerate(self._zones):
            xy = TARGET_CENTRE + [side * (1 - 2 * i) * TARGET_OFFSET, 0] + rng.uniform(-TARGET_SPREAD, TARGET_SPREAD)
            yaw = math.pi + rng.uniform(-TARGET_YAW_SPREAD, TARGET_YAW_SPREAD)
            self._place(body, xy, TARGET_HEIGHT, yaw)
            self._target_poses[i] = *xy, math.remainder(yaw, 2 * math.pi)

        self._simulate(SETTLE_STEPS)
        self._pairs = []
        observation = self._observation()
        if goal is None:
            goal = observation[None].copy()
            goal[:, [0, 1, 3, 4]] = observation[[10, 11, 13, 14]]
        return observation, {"tasks": (), "goal": fitting_goal(goal, observation)}

    def _draw_block_places(self) -> tuple[np.ndarray, np.ndarray]:
        """Places of the blocks: the first uniform, the second uniform where its x is far enough from the first's."""
        rng = self.np_random
        while True:
            first = BLOCK_CENTRE + rng.uniform(-BLOCK_SPREAD, BLOCK_SPREAD)
            for _ in range(1000):
                second = BLOCK_CENTRE + rng.uniform(-BLOCK_SPREAD, BLOCK_SPREAD)
                if abs(second[0] - first[0]) > MIN_BLOCK_GAP:
                    return first, second

    def _place(self, body: int, xy: np.ndarray, z: float, yaw: float) -> None:
        quaternion = (0, 0, math.sin(yaw / 2), math.cos(yaw / 2))
        self._client.resetBasePositionAndOrientation(body, (xy[0], xy[1], z), quaternion)

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Move the effector's target by `action` (metres), kept inside the workspace, and simulate 0.1 s.

        Raises:
            UserError: the action has another shape, or a number that is not finite: the arm's inverse kinematics would
                never end.
        """
        target = self._effector_target + numbers("action", action, (2,)).astype(np.float64)
        self._move_effector_target(np.clip(target, WORKSPACE_LOW, WORKSPACE_HIGH))
        self._simulate(SUBSTEPS)
        observation = self._observation()
        reward = self._reward(observation)
        return observation, reward, reward >= 0.5, False, {"tasks": tuple(self._pairs)}

    def _reward(self, observation: np.ndarray) -> float:
        """0.49 for each (block, target) pair entered for the first time; 0.51 instead when both targets are filled."""
        blocks = observation[[[0, 1], [3, 4]]]
        targets = observation[[[10, 11], [13, 14]]]
        distances = np.linalg.norm(blocks[:, None] - targets[None], axis=-1)  # (block, target)
        inside = distances < self.tolerance
        new = [2 * b + t for t in (0, 1) for b in (0, 1) if inside[b, t] and 2 * b + t not in self._pairs]
        self._pairs += new
        nearest = distances.argmin(axis=1)
        if inside[0, nearest[0]] and inside[1, nearest[1]] and nearest[0] != nearest[1]:
            return SUCCESS_REWARD
        return ENTRY_REWARD * len(new)

    def _observation(self) -> np.ndarray:
        observation = np.empty(16)
        for i, body in enumerate(self._blocks):
            position, (x, y, z, w) = self._client.getBasePositionAndOrientation(body)
            yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
            observation[3 * i : 3 * i + 3] = position[0], position[1], yaw
        observation[6:8] = self._client.getLinkState(self._arm, EFFECTOR_LINK)[0][:2]
        observation[8:10] = self._effector_target
        observation[10:] = self._target_poses.ravel()
        return observation

    def render(self) -> np.ndarray | None:
        """A picture of the scene from the far side of the table, (height, width, 3) uint8 RGB."""
        if self.render_mode is None:
            return None
        height, width = self.render_size
        view = self._client.computeViewMatrix([1.0, 0, 0.65], [0.36, 0, 0.0], [0, 0, 1])
        projection = self._client.computeProjectionMatrixFOV(45, width / height, 0.05, 3)
        pixels = self._client.getCameraImage(width, height, view, projection, renderer=pybullet.ER_TINY_RENDERER)[2]
        return np.asarray(pixels, dtype=np.uint8).reshape(height, width, 4)[:, :, :3]

    def close(self) -> None:
        """Disconnect from the physics server."""
        if self._client.isConnected():
            self._client.disconnect()


def fitting_goal(states: np.ndarray, observation: np.ndarray) -> np.ndarray:
    """A demonstration's last states as the goal of another episode.

    If the demonstration's targets lay the other way round, the two blocks' places are exchanged, so that the goal asks
    for the same pairing of blocks and targets.

    Args:
        states: (G, 16) last states of the demonstration.
        observation: (16,) first observation of the episode.

    Returns:
        (G, 16) goal states.
    """
    goal = states.copy()
    if np.linalg.norm(states[-1, 10:12] - observation[10:12]) > OTHER_SIDE:
        goal[:, 0:2], goal[:, 3:5] = states[:, 3:5], states[:, 0:2]
    return goal
