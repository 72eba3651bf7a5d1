"""What stands between the environment's observations and policies: nothing, they are states."""

from beso.envs.protocol import no_encoder as load

__all__ = ["load"]
