"""Trained models on disk: `seed<k>.safetensors` with the weights and `seed<k>.json` with everything else."""

import dataclasses
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import safetensors.torch
import torch
from safetensors import SafetensorError
from torch import Tensor
from torch.overrides import TorchFunctionMode

from beso import methods
from beso.config import build
from beso.core.device import Precision
from beso.core.training_config import TrainingJob
from beso.data.scaling import Scaling
from beso.data.spec import Sizes
from beso.encoders import finetuned
from beso.encoders.encoder import Encoding, FrameEncoder
from beso.errors import UserError
from beso.files import read_json, replacing, write_json

LEAST = 1 << 26  # bytes that any network may have before its weights are compared
SMALLEST = 1 << 12  # bytes that each tensor counts for at least


@dataclass(frozen=True)
class TrainedModel:
    """A trained model.

    Attributes:
        weights: averaged weights by name.
        scaling: between raw and its own units.
        curve: one row a measurement.
        encoding: how its own encoder, which was trained with it, takes frames; None if it has none.
        precision: of its training, "fp32" or "bf16"; None is what the job says.
    """

    weights: dict[str, Tensor]
    scaling: Scaling
    curve: list[dict[str, float]]
    encoding: Encoding | None = None
    precision: Precision | None = None


def as_they_are(observations: np.ndarray) -> np.ndarray:
    """What a model without an encoder makes of observations (B, O)."""
    return observations


@dataclass(frozen=True)
class LoadedModel:
    """A trained model, in evaluation mode, in its own units.

    Attributes:
        method: network and acting, see beso.core.method.BaseMethod.
        scaling: between raw and its own units.
        context: time steps that it sees in rollouts.
        goal_window: states in a goal.
        encode: its own encoder, where it was trained with one: frames (B, H, W, 3) -> raw observations (B, O).
        frame_size: height and width of the frames that its own encoder takes.
    """

    method: Any
    scaling: Scaling
    context: int
    goal_window: int = 1
    encode: Callable[[np.ndarray], np.ndarray] = as_they_are
    frame_size: int | None = None

    @property
    def observation_shape(self) -> tuple[int | None, ...]:
        """Shape of a raw observation: numbers, or a frame; None for a size that the model does not tell."""
        size = self.frame_size
        return (size, size, 3) if size else (self.scaling.observation_size,)


def paths(folder: Path, seed: int) -> tuple[Path, Path]:
    """The weights' and the description's file of one model seed."""
    return folder / f"seed{seed}.safetensors", folder / f"seed{seed}.json"


def save(folder: Path, job: TrainingJob, sizes: Sizes, trained: TrainedModel, data_digest: str) -> None:
    """Write one trained model; the description goes last, so that it is there only when the weights are."""
    weights, description = paths(folder, job.seed)
    with replacing(weights) as temporary:
        temporary.write_bytes(safetensors.torch.save(trained.weights))
    write_json(
        description,
        {
            "job": dataclasses.asdict(job),
            "sizes": sizes._asdict(),
            "data": data_digest,
            "scaling": trained.scaling.as_dict(),
            "torch": torch.__version__,
            "curve": trained.curve,
            **({"precision": trained.precision} if job.config.optimization.precision == "auto" else {}),
            **({} if trained.encoding is None else {"encoder": dataclasses.asdict(trained.encoding)}),
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
    absent = [key for key in ("job", "sizes", "data", "scaling", "curve") if key not in description]
    if absent:
        raise UserError(f"{path} is damaged: it has no {absent[0]!r}")
    return description


def check(folder: Path, job: TrainingJob) -> None:
    """Check that a folder holds what the caller believes it to hold.

    Raises:
        UserError: the model was trained with another configuration.
    """
    found = load_description(folder, job.seed)["job"]
    difference = _first_difference(found, json.loads(json.dumps(dataclasses.asdict(job))), "")
    if difference:
        where = paths(folder, job.seed)[1]
        raise UserError(f"{where} is a checkpoint of another configuration: {difference}; train again")


def config(folder: Path, seed: int) -> Any:
    """The Config of a trained model. Raises UserError if its description is missing or damaged."""
    return _config(load_description(folder, seed), paths(folder, seed)[1])


def _config(description: dict[str, Any], path: Path) -> Any:
    job = description["job"]
    try:
        name, model = job["method"], job["config"]["model"]
    except (TypeError, KeyError):
        raise UserError(f"{path} is damaged: its job has no method and model") from None
    return build(methods.load(str(name)).Config, model, f"{path}: model")


def _fits(found: Tensor, expected: Tensor) -> bool:
    """Whether a weight is of the expected shape and kind; an archive keeps it in half precision."""
    kinds = {expected.dtype, torch.float16} if expected.dtype == torch.float32 else {expected.dtype}
    return found.shape == expected.shape and found.dtype in kinds


def load(folder: Path, seed: int, sampling: Any, device: torch.device) -> LoadedModel:
    """Rebuild a trained policy.

    Args:
        sampling: how it shall generate actions: the method's Sampling, or None for its own default.

    Raises:
        UserError: files are missing or damaged, or the sampling does not fit the model.
    """
    weights_path, description_path = paths(folder, seed)
    description = load_description(folder, seed)
    config = _config(description, description_path)
    name, scaling = description["job"]["method"], build(Scaling, description["scaling"], f"{description_path}: scaling")
    sizes = _sizes(description["sizes"], scaling, description_path)
    try:
        weights = safetensors.torch.load(weights_path.read_bytes())
    except (OSError, SafetensorError) as error:
        raise UserError(f"{weights_path} is missing or damaged ({error})") from None
    for key, value in weights.items():
        if not value.isfinite().all():
            raise UserError(f"{weights_path} is damaged: {key} holds numbers that are not finite")
    unused = torch.Generator()  # initial weights, overwritten below
    wrong = UserError(f"{weights_path} is damaged: its weights are not those of a {name} of this configuration")
    try:
        with _AtMost(4 * sum(value.nbytes for value in weights.values()) + LEAST):
            method = methods.load(name).Method(config, sampling, sizes, unused)
    except (RuntimeError, MemoryError, OverflowError):
        raise wrong from None
    whole: torch.nn.Module = method
    encode: Callable[[np.ndarray], np.ndarray] = as_they_are
    frame_size = None
    if "encoder" in description:
        encoding = build(Encoding, description["encoder"], f"{description_path}: encoder")
        whole = finetuned.modules(method, encoding)
        encode, frame_size = FrameEncoder(whole["encoder"], encoding, device), encoding.size
    expected = whole.state_dict()
    if weights.keys() != expected.keys() or not all(_fits(weights[key], expected[key]) for key in expected):
        raise wrong
    whole.load_state_dict(weights)
    context = config.context
    if sampling is not None:
        try:
            config.check(sampling)
        except ValueError as error:
            raise UserError(f"{description_path}: sampling: {error}") from None
        context = sampling.context_steps(config.context)
    return LoadedModel(method.to(device).eval(), scaling, context, sizes.goal_window, encode, frame_size)


def _sizes(values: Any, scaling: Scaling, path: Path) -> Sizes:
    expected = {"observation": len(scaling.visible), "action": len(scaling.action_low)}
    goal_window = values.get("goal_window") if isinstance(values, dict) else None
    if type(goal_window) is not int or goal_window < 1 or values != {**expected, "goal_window": goal_window}:
        raise UserError(f"{path} is damaged: its sizes are not those of its scaling")
    return Sizes(**values)


class _AtMost(TorchFunctionMode):
    """No more than so many bytes of new tensors: a damaged description may ask for a network of any size."""

    def __init__(self, size: int) -> None:
        super().__init__()
        self._left = size

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        made = func(*args, **(kwargs or {}))
        if isinstance(made, Tensor) and not any(isinstance(argument, Tensor) for argument in args):
            self._left -= made.nbytes + SMALLEST  # many small ones take long
            if self._left < 0:
                raise MemoryError
        return made


def _first_difference(found: Any, expected: Any, key: str) -> str | None:
    """The first leaf where two JSON values differ, in words."""
    if isinstance(found, dict) and isinstance(expected, dict):
        for name in sorted(found.keys() | expected.keys()):
            difference = _first_difference(found.get(name), expected.get(name), f"{key}.{name}" if key else name)
            if difference:
                return difference
        return None
    return None if found == expected else f"{key} is {found!r} there and {expected!r} here"
