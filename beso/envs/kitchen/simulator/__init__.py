"""The simulated relay kitchen, `beso/Kitchen-v0`."""

from beso.envs.kitchen.simulator.environment import KitchenEnv

__all__ = ["KitchenEnv"]
