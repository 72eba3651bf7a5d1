"""What moves and lights up on the table: door, drawer, button, switch, lightbulb and led.

The button toggles the led each time it goes down past the middle of its travel. The switch sets the lightbulb by its
position, but only when it crosses the middle: a lightbulb that disagrees with its switch stays as it is until then.
"""

from typing import Final

import numpy as np

from beso.envs.calvin.simulator.client import Client
from beso.envs.calvin.simulator.observations import BUTTON, LED, LIGHTBULB, SLIDE, SWITCH
from beso.envs.calvin.simulator.urdf import SCALE

JOINTS: Final = ("base__slide", "base__drawer", "base__button", "base__switch")  # in the order of scene_obs
BRAKE_FORCE: Final = 4.0  # N; holds door, drawer and switch where they are left, and pushes the button up
BULB_ON, LED_ON, LIGHT_OFF = (1, 1, 0, 1), (0, 1, 0, 1), (1, 1, 1, 1)


class Fixtures:
    """The table in a physics server.

    Args:
        client: the server.
        urdf: path of the table's file.
    """

    def __init__(self, client: Client, urdf: str) -> None:
        self._client = client
        self.body: int = client.loadURDF(urdf, useFixedBase=True, globalScaling=SCALE)
        infos = [client.getJointInfo(self.body, i) for i in range(client.getNumJoints(self.body))]
        self.links: dict[int, str] = {-1: "base_link", **{i: info[12].decode() for i, info in enumerate(infos)}}
        index = {info[1].decode(): i for i, info in enumerate(infos)}
        self._joints = [index[name] for name in JOINTS]
        self._bulb, self._led = index["base__light"], index["base__led"]
        self.limits = np.array([infos[joint][8:10] for joint in self._joints])  # (4, 2) metres
        self._middle = self.limits.mean(axis=1)
        for joint in self._joints:
            spring = joint == self._joints[BUTTON]
            mode = client.POSITION_CONTROL if spring else client.VELOCITY_CONTROL
            target = {"targetPosition" if spring else "targetVelocity": 0.0}
            client.setJointMotorControl2(self.body, joint, mode, force=BRAKE_FORCE, **target)
        self._lights = [False, False]  # lightbulb, led
        self._button_down = self._switch_on = False

    def reset(self, fixtures: np.ndarray) -> None:
        """Set joints and lights to the first 6 numbers of a scene_obs."""
        for joint, position in zip(self._joints, fixtures[:4], strict=True):
            self._client.resetJointState(self.body, joint, position)
        self._button_down = bool(fixtures[BUTTON] > self._middle[BUTTON])
        self._switch_on = bool(fixtures[SWITCH] > self._middle[SWITCH])
        self._lights = [bool(fixtures[LIGHTBULB] > 0.5), bool(fixtures[LED] > 0.5)]
        self._colour()

    def update_lights(self) -> None:
        """Let button and switch act on the lights; to be called after every action."""
        positions = self.observation()
        button_down = bool(positions[BUTTON] > self._middle[BUTTON])
        switch_on = bool(positions[SWITCH] > self._middle[SWITCH])
        before = list(self._lights)
        if button_down and not self._button_down:
            self._lights[1] = not self._lights[1]
        if switch_on != self._switch_on:
            self._lights[0] = switch_on
        self._button_down, self._switch_on = button_down, switch_on
        if self._lights != before:
            self._colour()

    def _colour(self) -> None:
        bulb, led = self._lights
        self._client.changeVisualShape(self.body, self._bulb, rgbaColor=BULB_ON if bulb else LIGHT_OFF)
        self._client.changeVisualShape(self.body, self._led, rgbaColor=LED_ON if led else LIGHT_OFF)

    def observation(self) -> np.ndarray:
        """The first 6 numbers of scene_obs, (6,) float64."""
        values = np.empty(6)
        values[SLIDE : SWITCH + 1] = [state[0] for state in self._client.getJointStates(self.body, self._joints)]
        values[LIGHTBULB], values[LED] = self._lights
        return values
