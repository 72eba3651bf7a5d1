"""The simulated environment, `beso/BlockPush-v0`."""

from beso.envs.block_push.simulator.environment import BlockPushEnv

__all__ = ["BlockPushEnv"]
