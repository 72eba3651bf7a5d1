"""Where tensors live."""

import torch

from beso.errors import UserError


def pick_device(name: str) -> torch.device:
    """The device of that name; "auto" means the first GPU if there is one.

    Raises:
        UserError: "cuda" where there is none.
    """
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    if name == "cuda" and not torch.cuda.is_available():
        raise UserError("device = cuda: this PyTorch finds no GPU; auto or cpu are possible")
    return torch.device(name)
