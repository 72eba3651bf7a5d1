"""Where tensors live, and how they are multiplied there."""

from typing import Literal

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


def pick_precision(name: Literal["auto", "fp32", "bf16"], device: torch.device) -> Literal["fp32", "bf16"]:
    """The precision of that name; "auto" means bf16 where the device multiplies it, elsewhere fp32, faster there."""
    if name != "auto":
        return name
    if device.type == "cuda":
        return "bf16" if torch.cuda.is_bf16_supported(including_emulation=False) else "fp32"
    processor = torch.cpu.get_capabilities()
    return "bf16" if processor.get("avx512_bf16") or processor.get("amx_bf16") else "fp32"
