"""The CALVIN play table on PyBullet, `beso/Calvin-v0`."""

from beso.envs.calvin.simulator.environment import CalvinEnv

__all__ = ["CalvinEnv"]
