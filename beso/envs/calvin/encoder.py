"""What stands between CALVIN's static camera and policies: the encoder that lies beside the play data."""

from beso.images.encoder import load

__all__ = ["load"]
