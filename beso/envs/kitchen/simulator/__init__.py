"""The simulated relay kitchen, registered with gymnasium as `beso/Kitchen-v0` when this package is imported."""

import gymnasium

from beso.envs.kitchen.simulator.environment import KitchenEnv

__all__ = ["KitchenEnv"]

gymnasium.register("beso/Kitchen-v0", entry_point="beso.envs.kitchen.simulator:KitchenEnv")
