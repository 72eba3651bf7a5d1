"""The simulated environment, registered with gymnasium as `beso/BlockPush-v0`."""

import gymnasium

from beso.envs.block_push.simulator.environment import BlockPushEnv

__all__ = ["BlockPushEnv"]

gymnasium.register("beso/BlockPush-v0", entry_point="beso.envs.block_push.simulator:BlockPushEnv")
