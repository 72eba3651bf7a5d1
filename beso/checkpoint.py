"""Trained models on disk: `seed<k>.safetensors` with the weights and `seed<k>.json` with everything else."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import safetensors.torch
import torch
from safetensors import SafetensorError
from torch import nn

from beso import methods
from beso.data.scaling import Scaling
from beso.data.spec import PlaySpec
from beso.errors import UserError
from beso.files import read_json, replacing, write_json
from beso.training import Trained
from beso.training_config import TrainingJob


def paths(folder: Path, seed: int) -> tuple[Path, Path]:
    """The weights' and the description's file of one model seed."""
    return folder / f"seed{seed}.safetensors", folder / f"seed{seed}.json"


def save(folder: Path, job: TrainingJob, trained: Trained, data_digest: str) -> None:
    """Write one trained model; the description goes last, so that it is there only when the weights are."""
    weights, description = paths(folder, job.seed)
    with replacing(weights) as temporary:
        temporary.write_bytes(safetensors.torch.save(trained.weights))
    write_json(
        description,
        {
            "job": dataclasses.asdict(job),
            "data": data_digest,
            "scaling": trained.scaling.as_dict(),
            "torch": torch.__version__,
            "curve": trained.curve,
        },
    )


def load_description(folder: Path, seed: int) -> dict[str, Any]:
    """Everything about a model but its weights.

    Raises:
        UserError: the file is missing or damaged.
    """
    path = paths(folder, seed)[1]
    if not path.is_file():
        raise UserError(f"{path} is missing: train this model first")
    description = read_json(path)
    absent = [key for key in ("job", "data", "scaling", "curve") if key not in description]
    if absent:
        raise UserError(f"{path} is damaged: it has no {absent[0]!r}")
    return description


def load(
    folder: Path, job: TrainingJob, sampling: Any, spec: PlaySpec, device: torch.device
) -> tuple[nn.Module, Scaling]:
    """Rebuild a trained policy, in evaluation mode.

    Args:
        job: what the caller believes the model to be.
        sampling: how it shall generate actions.

    Raises:
        UserError: files are missing or damaged, or the model was trained with another configuration.
    """
    weights_path, description_path = paths(folder, job.seed)
    description = load_description(folder, job.seed)
    expected = json.loads(json.dumps(dataclasses.asdict(job)))
    difference = _first_difference(description["job"], expected, "")
    if difference:
        raise UserError(f"{description_path} is a checkpoint of another configuration: {difference}; train again")
    try:
        weights = safetensors.torch.load(weights_path.read_bytes())
    except (OSError, SafetensorError) as error:
        raise UserError(f"{weights_path} is missing or damaged ({error})") from None
    unused = torch.Generator()  # initial weights, overwritten below
    method = methods.load(job.method).Method(job.config.model, sampling, spec.sizes, unused)
    shapes = {key: tuple(value.shape) for key, value in weights.items()}
    if shapes != {key: tuple(value.shape) for key, value in method.state_dict().items()}:
        raise UserError(f"{weights_path} is damaged: its weights are not those of a {job.method} of this configuration")
    method.load_state_dict(weights)
    return method.to(device).eval(), Scaling.from_dict(description["scaling"])


def _first_difference(found: Any, expected: Any, key: str) -> str | None:
    """The first leaf where two JSON values differ, in words."""
    if isinstance(found, dict) and isinstance(expected, dict):
        for name in sorted(found.keys() | expected.keys()):
            difference = _first_difference(found.get(name), expected.get(name), f"{key}.{name}" if key else name)
            if difference:
                return difference
        return None
    return None if found == expected else f"{key} is {found!r} there and {expected!r} here"
