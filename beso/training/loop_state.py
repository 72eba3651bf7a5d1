"""The whole state of a training loop in one file, so that a killed run continues and ends with the same bytes."""

import hashlib
import json
import logging
from collections.abc import Mapping
from pathlib import Path

import safetensors.torch
import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor, nn

from beso.files import replacing

log = logging.getLogger(__name__)

Curve = list[dict[str, float]]


class LoopState:
    """Saves and restores everything a loop changes, in one safetensors file; numbers go into its header.

    Args:
        modules: by name; their parameters and buffers are saved.
        updates: optimizers of parameters in them.
        draws: the loop's random generator.
        loss_sum: what the loop sums up.
    """

    def __init__(
        self,
        modules: Mapping[str, nn.Module],
        updates: list[torch.optim.Optimizer],
        draws: torch.Generator,
        loss_sum: Tensor,
    ) -> None:
        self.draws = draws
        names = {id(p): f"{name}.{key}" for name, module in modules.items() for key, p in module.named_parameters()}
        self.parameters = {  # by name: the parameter, and the state of the optimizer that updates it
            names[id(parameter)]: (parameter, optimizer.state)
            for optimizer in updates
            for group in optimizer.param_groups
            for parameter in group["params"]
        }
        self.tensors = {f"{name}.{k}": v for name, module in modules.items() for k, v in module.state_dict().items()}
        self.tensors["loss_sum"] = loss_sum

    def save(self, path: Path, step: int, curve: Curve) -> None:
        """Write the state after `step` steps, atomically."""
        tensors = {key: value.contiguous() for key, value in self.tensors.items()}
        for name, (parameter, state) in self.parameters.items():
            for key, value in state[parameter].items():
                tensors[f"optimizer.{name}.{key}"] = value.contiguous()
        tensors["draws"] = self.draws.get_state()
        with replacing(path) as temporary:
            metadata = {"step": str(step), "curve": json.dumps(curve)}
            metadata["sha256"] = _digest(tensors, metadata)
            temporary.write_bytes(safetensors.torch.save(tensors, metadata))

    def load(self, path: Path) -> tuple[int, Curve]:
        """Restore a state; the number of steps done and the curve. Both are empty where there is no whole file."""
        if not path.exists():
            return 0, []
        try:
            with safe_open(path, "pt") as file:
                tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118 (not a dictionary)
                metadata = file.metadata() or {}
        except SafetensorError:
            tensors, metadata = {}, {}
        if metadata.pop("sha256", None) != _digest(tensors, metadata):
            log.warning("%s is damaged; starting again", path)
            return 0, []
        with torch.no_grad():
            for key, value in self.tensors.items():
                value.copy_(tensors[key])
            for name, (parameter, state) in self.parameters.items():
                prefix = f"optimizer.{name}."
                keys = [key for key in tensors if key.startswith(prefix)]
                state[parameter] = {k.removeprefix(prefix): _like(parameter, tensors[k]) for k in keys}
            self.draws.set_state(tensors["draws"])
        return int(metadata["step"]), json.loads(metadata["curve"])


def _digest(tensors: Mapping[str, Tensor], metadata: Mapping[str, str]) -> str:
    """The SHA-256 of a state: a flipped bit would train on unnoticed."""
    digest = hashlib.sha256(json.dumps(metadata, sort_keys=True).encode())
    for name in sorted(tensors):
        value = tensors[name].detach().cpu().contiguous()
        digest.update(f"{name} {value.dtype} {tuple(value.shape)}".encode())
        digest.update(value.reshape(-1).view(torch.uint8).numpy().data)
    return digest.hexdigest()


def _like(parameter: Tensor, value: Tensor) -> Tensor:
    """An optimizer's tensor on the parameter's device (the step count too: fused optimizers keep it there).

    In memory it is laid out as the parameter is (channels last, say), as the optimizer had made it.
    """
    if value.shape != parameter.shape:
        return value.to(parameter.device)
    return torch.empty_like(parameter).copy_(value)
