"""Where tensors live, and how they are multiplied there."""

import re
from typing import Literal

import torch

from beso.errors import UserError

Precision = Literal["fp32", "bf16"]
PrecisionOrAuto = Literal["auto", "fp32", "bf16"]


def pick_device(name: str) -> torch.device:
    """The device of that name; "auto" means the first GPU if there is one.

    Args:
        name: "auto", "cpu", "cuda", or one of several GPUs, counted from 0: "cuda:1".

    Raises:
        UserError: another name, or a GPU where there is none of that number.
    """
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    if not re.fullmatch(r"cpu|cuda(:\d{1,3})?", str(name)):
        raise UserError(f"device = {name!r}: must be auto, cpu, cuda, or one GPU as cuda:0, cuda:1")
    device = torch.device(name)
    if device.type == "cuda" and not torch.cuda.is_available():
        raise UserError(f"device = {name}: this PyTorch finds no GPU; auto or cpu are possible")
    if device.index is not None and device.index >= torch.cuda.device_count():
        raise UserError(f"device = {name}: the last GPU here is cuda:{torch.cuda.device_count() - 1}")
    return device


def pick_precision(name: PrecisionOrAuto, device: torch.device) -> Precision:
    """The precision of that name; "auto" means bf16 where the device multiplies it, elsewhere fp32, faster there."""
    if name != "auto":
        return name
    if device.type == "cuda":
        return "bf16" if torch.cuda.is_bf16_supported(including_emulation=False) else "fp32"
    processor = torch.cpu.get_capabilities()
    return "bf16" if processor.get("avx512_bf16") or processor.get("amx_bf16") else "fp32"
