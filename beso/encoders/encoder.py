"""The encoder between camera frames and policies, on disk beside the play data that it made.

encoder.safetensors   the network's weights, by torchvision's names
encoder.json          architecture, frame size, channel statistics, precision, where the weights come from, SHA-256
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import safetensors.torch
import torch
from torch import Tensor, nn

from beso.config import build, require
from beso.core.device import Precision
from beso.encoders.resnet import FEATURES, Head, ResNet18, check_width
from beso.errors import UserError
from beso.files import check_sha256, read_json, replacing, sha256, write_json

WEIGHTS, DESCRIPTION = "encoder.safetensors", "encoder.json"
LARGEST: Final = 4096  # pixels
BATCH: Final = 16  # always so many frames at a time: another batch size is another order of sums in the products


@dataclass(frozen=True)
class Encoding:
    """How frames become features, apart from the weights.

    Attributes:
        width, head: of the network, see beso.encoders.resnet.
        size: height and width of the frames, pixels.
        mean, std: by which red, green and blue, in [0, 1], are standardised.
        precision: "fp32", or "bf16" for autocast.
    """

    width: int
    size: int
    mean: tuple[float, ...]
    std: tuple[float, ...]
    precision: Precision
    head: Head = "average"  # of encoders of earlier versions, which do not tell

    def __post_init__(self) -> None:
        check_width(self.width)
        require(1 <= self.size <= LARGEST, f"size = {self.size}: must be at least 1 and at most {LARGEST}")
        require(len(self.mean) == len(self.std) == 3, "mean and std must have three numbers each")
        require(min(self.std) > 0, f"std = {list(self.std)}: must be above 0")

    def standardise(self, frames: Tensor) -> Tensor:
        """(B, H, W, 3) uint8 -> (B, 3, H, W) float32, channels last in memory."""
        mean, std = (255 * torch.tensor(values, device=frames.device) for values in (self.mean, self.std))
        return ((frames - mean) / std).permute(0, 3, 1, 2)


def shifted(frames: np.ndarray, corners: np.ndarray, shift: int) -> np.ndarray:
    """Frames (B, H, W, 3) moved by up to `shift` pixels, their borders repeated.

    Args:
        corners: (B, 2) row and column, 0 to 2 * shift, at which the frame is cut from the padded one.
    """
    if shift == 0:
        return frames
    padded = np.pad(frames, ((0, 0), (shift, shift), (shift, shift), (0, 0)), mode="edge")
    height, width = frames.shape[1:3]
    cut = [frame[y : y + height, x : x + width] for frame, (y, x) in zip(padded, corners, strict=True)]
    return np.stack(cut)


class FrameEncoder:
    """Maps frames to features on one device. A frame's features depend on that frame alone, to the last bit."""

    def __init__(self, network: nn.Module, encoding: Encoding, device: torch.device) -> None:
        self.encoding, self.device = encoding, device
        self.network = network.to(device, memory_format=torch.channels_last).eval()  # type: ignore[call-overload]

    def __call__(self, frames: np.ndarray) -> np.ndarray:
        """Features (B, 512) float32 of frames (B, size, size, 3) uint8 RGB.

        Raises:
            UserError: frames of another size.
        """
        size = self.encoding.size
        if frames.shape[1:] != (size, size, 3) or frames.dtype != np.uint8:
            raise UserError(
                f"the encoder takes uint8 frames (B, {size}, {size}, 3), not {frames.dtype} {frames.shape}:"
                " the camera, data/frames and the encoder must have one size"
            )
        features = np.empty((len(frames), FEATURES), dtype=np.float32)
        batch = np.zeros((BATCH, size, size, 3), dtype=np.uint8)
        for start in range(0, len(frames), BATCH):
            part = frames[start : start + BATCH]
            batch[: len(part)] = part
            features[start : start + BATCH] = self._encode(batch)[: len(part)]
        return features

    @torch.inference_mode()
    def _encode(self, batch: np.ndarray) -> np.ndarray:
        pictures = self.encoding.standardise(torch.from_numpy(batch).to(self.device))
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.encoding.precision == "bf16"):
            return self.network(pictures).float().cpu().numpy()


def save(
    folder: Path, network: ResNet18, encoding: Encoding, provenance: Mapping[str, Any], shift: int | None = None
) -> None:
    """Write the encoder's two files into an existing folder.

    Args:
        shift: of an encoder that is trained on with each policy (beso.encoders.finetuned): the largest random shift.
    """
    weights = {name: value.cpu().contiguous() for name, value in network.state_dict().items()}
    with replacing(folder / WEIGHTS) as temporary:
        temporary.write_bytes(safetensors.torch.save(weights))
    description = {
        "architecture": "resnet18",
        "encoding": dataclasses.asdict(encoding),
        "provenance": dict(provenance),
        "sha256": sha256(folder / WEIGHTS),
        **({} if shift is None else {"finetune": True, "shift": shift}),
    }
    write_json(folder / DESCRIPTION, description)


def load(folder: Path, device: torch.device) -> FrameEncoder:
    """Read an encoder.

    Raises:
        UserError: a file is missing, damaged or altered.
    """
    description = read_json(folder / DESCRIPTION)
    encoding = build(Encoding, description.get("encoding"), f"{folder / DESCRIPTION}: encoding")
    weights = folder / WEIGHTS
    if not weights.is_file():
        raise UserError(f"{weights} is missing")
    check_sha256(weights, description.get("sha256"), DESCRIPTION)
    return FrameEncoder(network(encoding, safetensors.torch.load_file(weights), str(weights)), encoding, device)


def untrained(encoding: Encoding, generator: torch.Generator) -> ResNet18:
    """A network with initial weights from the generator."""
    return ResNet18(encoding.width, generator, encoding.head)


def network(encoding: Encoding, weights: Mapping[str, Tensor], where: str) -> ResNet18:
    """A network with given weights; those of a classifier, `fc.*`, are left out.

    Raises:
        UserError: they are not the weights of a ResNet-18 of this width and head.
    """
    made = untrained(encoding, torch.Generator())  # initial weights, overwritten below
    expected = {name: tuple(value.shape) for name, value in made.state_dict().items()}
    found = {name: value for name, value in weights.items() if not name.startswith("fc.")}
    for name in sorted(expected.keys() | found.keys()):
        shape = tuple(found[name].shape) if name in found else None
        if shape != expected.get(name):
            mismatch = f"{name} has shape {shape}, not {expected.get(name)}"
            raise UserError(f"{where} does not hold a ResNet-18 of width {encoding.width}: {mismatch}")
    for name, value in found.items():
        if not value.isfinite().all():
            raise UserError(f"{where}: {name} holds numbers that are not finite")
    made.load_state_dict(found)
    return made
