"""Control of the arm: a pose that the hand should have -> the joint velocities that take it there.

Damped least squares with joint limits and a preferred posture, and on top of it the inverse of the kitchen's servos.
An action asks for a position at most 0.16 rad from where a joint is, the servo covers a known share of that in one
step, and gravity pulls the joint away from it by a known angle: both are made good, so that the hand moves as asked
within 1 or 2 percent and does not sag.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

JOINTS = 7
STEP_SECONDS = 0.08
REACH = 2.0 * STEP_SECONDS  # rad (m for fingers) that an action of 1 asks for
LARGEST_ACTION = 0.999

# A little inside the limits to which the kitchen clips what it is asked for
LOWEST = np.array([-2.88, -1.7628, -2.88, -3.05, -2.88, 0.0, -2.88])
HIGHEST = np.array([2.88, 1.7628, 2.88, -0.42, 2.88, 2.10, 2.88])
POSTURE = np.array([-0.9, -1.70, 1.6, -2.1, 0.0, 1.2, 1.7])  # rad; the arm bent over the stove, elbow to the left
POSTURE_GAIN = 0.05  # a step

WEIGHTS = np.array([1.0, 1.0, 1.0, 0.25, 0.25, 0.25])  # metres against radians
DAMPING = 0.03**2 * np.diag([0.3, 0.3, 0.3, 1.0, 1.0, 1.0])


@dataclass(frozen=True)
class Pose:
    """A place (3,) in metres and a rotation (3, 3), world coordinates; x is right, y towards the wall, z up."""

    position: np.ndarray
    rotation: np.ndarray

    def moved(self, x: float, y: float, z: float) -> "Pose":
        """The pose shifted by so many metres."""
        return Pose(self.position + [x, y, z], self.rotation)


def hand_rotation(yaw: float, pitch: float = 0.0, roll: float = 0.0) -> np.ndarray:
    """The rotation (3, 3) of a hand that points to the wall (its z axis), its fingers opening sideways (its y axis).

    Args:
        yaw: radians by which it points to the right.
        pitch: radians by which it points up.
        roll: radians by which it is turned about the direction in which it points.
    """
    z = np.array([np.sin(yaw) * np.cos(pitch), np.cos(yaw) * np.cos(pitch), np.sin(pitch)])
    y = np.array([np.cos(yaw), -np.sin(yaw), 0.0])
    x = np.cross(y, z)
    c, s = np.cos(roll), np.sin(roll)
    return np.stack([c * x + s * y, -s * x + c * y, z], axis=1)


def rotation_vector(rotation: np.ndarray) -> np.ndarray:
    """Axis times angle (3,), radians, of a rotation (3, 3)."""
    quaternion, vector = np.empty(4), np.empty(3)
    mujoco.mju_mat2Quat(quaternion, rotation.flatten())
    mujoco.mju_quat2Vel(vector, quaternion, 1.0)
    return vector


def errors(target: Pose, pose: Pose) -> tuple[np.ndarray, np.ndarray]:
    """What is missing from `pose` to `target`: metres (3,) and a rotation vector (3,) in radians."""
    return target.position - pose.position, rotation_vector(target.rotation @ pose.rotation.T)


class Arm:
    """The Franka arm of a kitchen.

    Args:
        model, data: the simulation. The controller reads the true state; the observed one is too noisy for it.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._model, self._data = model, data
        self._hand = model.site("end_effector").id
        self._stiffness = model.actuator_gainprm[:JOINTS, 0].copy()  # N m / rad
        damping = model.dof_damping[:JOINTS]
        self._covered = 1 - np.exp(-self._stiffness * STEP_SECONDS / damping)  # of the angle asked for, in one step

    def pose(self) -> Pose:
        """Where the hand is; the fingertips reach 5 cm further."""
        return Pose(self._data.site_xpos[self._hand].copy(), self._data.site_xmat[self._hand].reshape(3, 3).copy())

    def action(
        self, target: Pose, fingers: float, speed: float, turn: float, force: np.ndarray | None = None
    ) -> np.ndarray:
        """The action that brings the hand closer to a pose.

        Args:
            target: the pose.
            fingers: distance of each finger from the middle, 0 to 0.04 m.
            speed: at most so many metres a step.
            turn: at most so many radians a step.
            force: newtons (3,) with which the hand presses on top of moving, world coordinates.

        Returns:
            (9,) in [-1, 1].
        """
        distance, rotation = errors(target, self.pose())
        jacobian = np.zeros((6, self._model.nv))
        mujoco.mj_jacSite(self._model, self._data, jacobian[:3], jacobian[3:], self._hand)
        jacobian = jacobian[:, :JOINTS]
        step = self._joint_step(jacobian, np.concatenate([_at_most(distance, speed), _at_most(rotation, turn)]))

        sag = self._data.qfrc_bias[:JOINTS] / self._stiffness
        longest = (LARGEST_ACTION * REACH - np.abs(sag)) * self._covered
        step = step / max(1.0, np.max(np.abs(step) / longest))
        asked = step / self._covered + sag
        if force is not None:
            asked += jacobian[:3].T @ force / self._stiffness
        finger_steps = fingers - self._data.qpos[JOINTS : JOINTS + 2]
        return np.clip(np.concatenate([asked, finger_steps]) / REACH, -1.0, 1.0)

    def _joint_step(self, jacobian: np.ndarray, twist: np.ndarray) -> np.ndarray:
        """Joint angles (7,) to move by so that the hand moves by `twist` (6,), as nearly as the joints' limits allow.

        Joints that would leave their range stop at its end, and the others are solved for again.
        """
        jacobian, twist = WEIGHTS[:, None] * jacobian, WEIGHTS * twist
        angles = self._data.qpos[:JOINTS]
        lowest, highest, preferred = LOWEST - angles, HIGHEST - angles, POSTURE_GAIN * (POSTURE - angles)
        step, free = np.zeros(JOINTS), np.ones(JOINTS, dtype=bool)
        while free.sum() >= 4:
            part = jacobian[:, free]
            rest = twist - jacobian[:, ~free] @ step[~free]
            solved = np.linalg.solve(part @ part.T + DAMPING, np.column_stack([rest, part]))
            step[free] = part.T @ solved[:, 0] + preferred[free] - part.T @ solved[:, 1:] @ preferred[free]
            outside = free & ((step < lowest - 1e-6) | (step > highest + 1e-6))
            if not outside.any():
                break
            step[outside] = np.clip(step[outside], lowest[outside], highest[outside])
            free &= ~outside
        return step


def _at_most(vector: np.ndarray, length: float) -> np.ndarray:
    return vector * min(1.0, length / max(float(np.linalg.norm(vector)), 1e-9))
