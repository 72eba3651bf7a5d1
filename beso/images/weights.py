"""Published weights of an encoder, from a local file."""

from collections.abc import Mapping
from pathlib import Path

import safetensors.torch
import torch
from torch import Tensor

from beso.errors import UserError
from beso.files import sha256


def read_weights(path: Path, digest: str) -> Mapping[str, Tensor]:
    """A state dictionary, from a .safetensors file or from one of torch (.pth), which is read without unpickling code.

    Args:
        digest: the file's SHA-256.

    Raises:
        UserError: the file is missing, is another one, or holds more than named tensors.
    """
    if not path.is_file():
        raise UserError(f"{path} is missing: features.weights names it")
    if (found := sha256(path)) != digest:
        raise UserError(f"{path} has SHA-256 {found}, but features.weights says {digest}")
    try:
        if path.suffix == ".safetensors":
            return safetensors.torch.load_file(path)
        state = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # both libraries raise many kinds, with advice that does not belong here
        raise UserError(f"{path} is damaged or holds more than plain tensors ({type(error).__name__})") from None
    if not isinstance(state, Mapping) or not all(isinstance(value, Tensor) for value in state.values()):
        raise UserError(f"{path} does not hold tensors by name")
    return state
