"""The Panda arm under CALVIN's relative Cartesian control.

Each action moves an internal target pose; inverse kinematics turns it into targets for the joints' motors. The target
follows the commands and not the arm: where the arm is blocked, it runs ahead.
"""

from typing import Final

import numpy as np

from beso.envs.calvin.simulator.client import Client
from beso.envs.calvin.simulator.observations import (
    ARM_JOINTS,
    CLOSE,
    GRIPPER_COMMAND,
    GRIPPER_WIDTH,
    OPEN,
    ROBOT_SIZE,
    TCP_EULER,
    TCP_POSITION,
)

BASE_POSITION = (-0.34, -0.46, 0.24)
NEUTRAL_JOINTS = np.array([-1.21779206, 1.03987646, 2.11978261, -2.34205014, -0.87015947, 1.64119353, 0.55344866])
JOINT_LOW = np.array([-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973])
JOINT_HIGH = np.array([2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973])

POSITION_STEP: Final = 0.02  # m an action of 1
ANGLE_STEP: Final = 0.05  # rad an action of 1
ARM_FORCE, ARM_VELOCITY = 200.0, 2.0  # N m, rad/s
FINGER_OPEN: Final = 0.04  # m of one finger; the gripper's width is twice that
CLOSING_FORCE, OPENING_FORCE, FINGER_VELOCITY = 200.0, 2.0, 1.0  # N, N, m/s


def neutral_robot_obs() -> np.ndarray:
    """(15,) robot_obs of an open gripper at the pose from which episodes start; the tcp's own entries are zero."""
    robot_obs = np.zeros(ROBOT_SIZE)
    robot_obs[GRIPPER_WIDTH], robot_obs[ARM_JOINTS], robot_obs[GRIPPER_COMMAND] = 2 * FINGER_OPEN, NEUTRAL_JOINTS, OPEN
    return robot_obs


class Arm:
    """One arm in a physics server.

    Args:
        client: the server.
        urdf: path of the arm's file.
    """

    def __init__(self, client: Client, urdf: str) -> None:
        self._client = client
        self.body: int = client.loadURDF(urdf, basePosition=BASE_POSITION, useFixedBase=True)
        joints = [client.getJointInfo(self.body, i) for i in range(client.getNumJoints(self.body))]
        index = {info[1].decode(): i for i, info in enumerate(joints)}
        self._arm = [index[f"panda_joint{i}"] for i in range(1, 8)]
        self._fingers = [index["panda_finger_joint1"], index["panda_finger_joint2"]]
        self._tcp = index["tcp_joint"]
        self._stand()
        self._couple_fingers()
        self.target_position, self.target_euler = np.zeros(3), np.zeros(3)
        self._command = OPEN

    def _stand(self) -> None:
        """A white pillar under the arm; it is only seen."""
        x, y, z = BASE_POSITION
        shape = self._client.createVisualShape(
            self._client.GEOM_CYLINDER,
            radius=0.13,
            length=z,
            rgbaColor=(1, 1, 1, 1),
            visualFramePosition=(x - 0.05, y, z / 2),
        )
        self._client.createMultiBody(baseVisualShapeIndex=shape)

    def _couple_fingers(self) -> None:
        """Keep the two fingers at equal distances from the hand's middle."""
        left, right = self._fingers
        gear = self._client.createConstraint(
            self.body, left, self.body, right, self._client.JOINT_GEAR, (1, 0, 0), (0, 0, 0), (0, 0, 0)
        )
        self._client.changeConstraint(gear, gearRatio=-1, erp=0.1, maxForce=50)

    def reset(self, robot_obs: np.ndarray) -> None:
        """Put the arm at the joint positions of `robot_obs` (15,), at rest.

        If the last command there is to close, the fingers go on closing, so that a block stays held; CALVIN's own reset
        makes them keep their width, which drops it.
        """
        for joint, angle in zip(self._arm, robot_obs[ARM_JOINTS], strict=True):
            self._client.resetJointState(self.body, joint, angle)
        for finger in self._fingers:
            self._client.resetJointState(self.body, finger, robot_obs[GRIPPER_WIDTH] / 2)
        self._drive_arm(robot_obs[ARM_JOINTS])
        self._drive_fingers(OPEN if robot_obs[GRIPPER_COMMAND] > 0 else CLOSE)
        position, quaternion = self._client.getLinkState(self.body, self._tcp, computeForwardKinematics=True)[:2]
        self.target_position = np.array(position)
        self.target_euler = np.array(self._client.getEulerFromQuaternion(quaternion))

    def act(self, action: np.ndarray) -> None:
        """Move the target by a relative action (7,): xyz, euler xyz, gripper, each within -1 and 1 (clipped).

        The gripper opens above 0 and closes otherwise: CALVIN takes nothing but +1 and -1.
        """
        action = np.clip(np.asarray(action, dtype=np.float64), -1, 1)
        self.target_position = self.target_position + POSITION_STEP * action[:3]
        self.target_euler = self.target_euler + ANGLE_STEP * action[3:6]
        # The null space keeps the elbow near where it was at the start; the limits of CALVIN's call are this wide.
        joints = self._client.calculateInverseKinematics(
            self.body,
            self._tcp,
            self.target_position,
            self._client.getQuaternionFromEuler(self.target_euler),
            lowerLimits=[-7.0] * 9,
            upperLimits=[7.0] * 9,
            jointRanges=[7.0] * 9,
            restPoses=[*NEUTRAL_JOINTS, FINGER_OPEN, FINGER_OPEN],
        )
        self._drive_arm(np.clip(joints[:7], JOINT_LOW, JOINT_HIGH))
        self._drive_fingers(OPEN if action[6] > 0 else CLOSE)

    def _drive_arm(self, angles: np.ndarray) -> None:
        for joint, angle in zip(self._arm, angles, strict=True):
            self._client.setJointMotorControl2(
                self.body,
                joint,
                self._client.POSITION_CONTROL,
                targetPosition=angle,
                force=ARM_FORCE,
                maxVelocity=ARM_VELOCITY,
            )

    def _drive_fingers(self, command: float) -> None:
        self._command = command
        for finger in self._fingers:
            self._client.setJointMotorControl2(
                self.body,
                finger,
                self._client.POSITION_CONTROL,
                targetPosition=FINGER_OPEN if command == OPEN else 0.0,
                force=OPENING_FORCE if command == OPEN else CLOSING_FORCE,
                maxVelocity=FINGER_VELOCITY,
            )

    def observation(self) -> np.ndarray:
        """robot_obs, (15,) float64."""
        robot_obs = np.empty(ROBOT_SIZE)
        position, quaternion = self._client.getLinkState(self.body, self._tcp)[:2]
        joints = [state[0] for state in self._client.getJointStates(self.body, [*self._arm, *self._fingers])]
        robot_obs[TCP_POSITION] = position
        robot_obs[TCP_EULER] = self._client.getEulerFromQuaternion(quaternion)
        robot_obs[GRIPPER_WIDTH] = joints[7] + joints[8]
        robot_obs[ARM_JOINTS] = joints[:7]
        robot_obs[GRIPPER_COMMAND] = self._command
        return robot_obs
