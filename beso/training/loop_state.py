"""The whole state of a training loop in one file, so that a killed run continues and ends with the same bytes."""

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
            temporary.write_bytes(safetensors.torch.save(tensors, metadata))

    def load(self, path: Path) -> tuple[int, Curve]:
        """Restore a state; the number of steps done and the curve. Both are empty where there is no whole file."""
        if not path.exists():
            return 0, []
        try:
            opened = safe_open(path, "pt")
        except SafetensorError:
            log.warning("%s is damaged; starting again", path)
            return 0, []
        with opened as file, torch.no_grad():
            for key, value in self.tensors.items():
                value.copy_(file.get_tensor(key))
            for name, (parameter, state) in self.parameters.items():
                prefix = f"optimizer.{name}."
                keys = [key for key in file.keys() if key.startswith(prefix)]  # noqa: SIM118 (not a dictionary)
                state[parameter] = {k.removeprefix(prefix): _like(parameter, file.get_tensor(k)) for k in keys}
            self.draws.set_state(file.get_tensor("draws"))
            metadata = file.metadata()
        return int(metadata["step"]), json.loads(metadata["curve"])


def _like(parameter: Tensor, value: Tensor) -> Tensor:
    """An optimizer's tensor on the parameter's device (the step count too: fused optimizers keep it there).

    In memory it is laid out as the parameter is (channels last, say), as the optimizer had made it.
    """
    if value.shape != parameter.shape:
        return value.to(parameter.device)
    return torch.empty_like(parameter).copy_(value)
