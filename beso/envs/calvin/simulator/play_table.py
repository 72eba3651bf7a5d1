"""The simulated play table: physics without gymnasium, and without pictures unless they are asked for."""

import tempfile
from pathlib import Path
from typing import Final

import numpy as np
import pybullet_data

from beso.checks import numbers
from beso.envs.calvin.simulator.arm import Arm, neutral_robot_obs
from beso.envs.calvin.simulator.assets import Assets, official_assets, write_assets
from beso.envs.calvin.simulator.camera import picture
from beso.envs.calvin.simulator.client import Client
from beso.envs.calvin.simulator.fixtures import Fixtures
from beso.envs.calvin.simulator.observations import (
    ACTION_SIZE,
    BLOCKS,
    DRAWER,
    FIXTURES,
    LED,
    LIGHTBULB,
    ROBOT_SIZE,
    SCENE_SIZE,
    SLIDE,
    block_slice,
)
from beso.envs.calvin.simulator.state import FLOOR, ROBOT, TABLE, BlockState, TableState
from beso.envs.calvin.simulator.urdf import SCALE

CONTROL_HZ, PHYSICS_HZ = 30, 240
SUBSTEPS: Final = PHYSICS_HZ // CONTROL_HZ


class PlayTable:
    """The table, the arm and the blocks in a physics server of their own.

    Args:
        assets: folder with CALVIN's own files (see `assets`), or None for ours.

    Raises:
        UserError: a file is missing in `assets`.
    """

    def __init__(self, assets: Path | None = None) -> None:
        self._official = None if assets is None else official_assets(assets)
        self._client = Client()
        self._load()

    def _load(self) -> None:
        """Build the scene anew, 22 ms.

        Moving everything back into place would be cheaper, but PyBullet keeps contact pairs of earlier episodes in an
        order of its own, in spite of its parameter: half the episodes came out differently.
        """
        self._client.resetSimulation()
        self._client.setPhysicsEngineParameter(deterministicOverlappingPairs=1)
        self._client.setGravity(0, 0, -9.8)
        if self._official is not None:
            self._load_files(self._official)
        else:
            with tempfile.TemporaryDirectory() as folder:
                self._load_files(write_assets(Path(folder)))

    def _load_files(self, assets: Assets) -> None:
        client = self._client
        self._blocks = [client.loadURDF(str(path), globalScaling=SCALE) for path in assets.blocks]
        self.fixtures = Fixtures(client, str(assets.table))
        self._floor = client.loadURDF(f"{pybullet_data.getDataPath()}/plane.urdf")
        if self._official is None:
            client.changeVisualShape(self._floor, -1, rgbaColor=(1, 1, 1, 0))  # not drawn: `camera.picture` fills it in
        self.arm = Arm(client, str(assets.panda))
        self._names = {
            self.arm.body: ROBOT,
            self.fixtures.body: TABLE,
            self._floor: FLOOR,
            **dict(zip(self._blocks, BLOCKS, strict=True)),
        }

    def reset(self, scene_obs: np.ndarray, robot_obs: np.ndarray | None = None) -> None:
        """Put everything, at rest, where `scene_obs` (24,) and `robot_obs` (15,) say; None: the arm's neutral pose.

        One step of physics follows, as in CALVIN: contacts are known only after it.

        Raises:
            UserError: an array of another shape, or a number that is not finite.
        """
        scene_obs = numbers("scene_obs", scene_obs, (SCENE_SIZE,))
        robot_obs = neutral_robot_obs() if robot_obs is None else numbers("robot_obs", robot_obs, (ROBOT_SIZE,))
        self._load()
        self.fixtures.reset(scene_obs[FIXTURES])
        for i, body in enumerate(self._blocks):
            pose = scene_obs[block_slice(i)]
            quaternion = self._client.getQuaternionFromEuler(pose[3:])
            self._client.resetBasePositionAndOrientation(body, pose[:3], quaternion)
        self.arm.reset(robot_obs)
        self._client.stepSimulation()

    def step(self, action: np.ndarray) -> None:
        """Carry out a relative action (7,) for 1/30 s.

        Raises:
            UserError: it is not 7 finite numbers: the arm's inverse kinematics would never end.
        """
        self.arm.act(numbers("action", action, (ACTION_SIZE,)))
        for _ in range(SUBSTEPS):
            self._client.stepSimulation()
        self.fixtures.update_lights()

    def robot_obs(self) -> np.ndarray:
        """The arm's state, (15,) float64; see `observations`."""
        return self.arm.observation()

    def scene_obs(self) -> np.ndarray:
        """The table's state, (24,) float64; see `observations`."""
        scene_obs = np.empty(SCENE_SIZE)
        scene_obs[FIXTURES] = self.fixtures.observation()
        for i, body in enumerate(self._blocks):
            position, quaternion = self._client.getBasePositionAndOrientation(body)
            scene_obs[block_slice(i)] = *position, *self._client.getEulerFromQuaternion(quaternion)
        return scene_obs

    def state(self) -> TableState:
        """What tasks are judged from."""
        fixtures = self.fixtures.observation()
        return TableState(
            slide=float(fixtures[SLIDE]),
            drawer=float(fixtures[DRAWER]),
            lightbulb=bool(fixtures[LIGHTBULB]),
            led=bool(fixtures[LED]),
            blocks={name: self._block_state(body) for name, body in zip(BLOCKS, self._blocks, strict=True)},
            touched_by_robot=frozenset(
                self._names[point[2]] for point in self._client.getContactPoints(bodyA=self.arm.body)
            ),
        )

    def _block_state(self, body: int) -> BlockState:
        position, quaternion = self._client.getBasePositionAndOrientation(body)
        linear, angular = self._client.getBaseVelocity(body)
        points = self._client.getContactPoints(bodyA=body)
        return BlockState(
            position=position,
            quaternion=quaternion,
            velocity=(*linear, *angular),
            touched=frozenset(self._names[point[2]] for point in points),
            touched_links=frozenset(self.fixtures.links[p[4]] for p in points if p[2] == self.fixtures.body),
        )

    def picture(self, size: int) -> np.ndarray:
        """What the static camera sees, (size, size, 3) uint8 RGB."""
        return picture(self._client, size)

    def close(self) -> None:
        """Disconnect from the physics server."""
        self._client.close()
