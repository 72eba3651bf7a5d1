"""The CALVIN play table on PyBullet; importing this package registers `beso/Calvin-v0` with gymnasium."""

import gymnasium

from beso.envs.calvin.simulator.environment import CalvinEnv

__all__ = ["CalvinEnv"]

gymnasium.register("beso/Calvin-v0", entry_point="beso.envs.calvin.simulator.environment:CalvinEnv")
