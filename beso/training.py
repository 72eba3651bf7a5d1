"""One training loop for every method: windows by index, EMA with warm-up, checkpoints, exact resume.

The loop's whole state (weights, averages, optimizer, random generator, step, curve) goes to one file now and then; a
run that is killed continues from it and ends with the same bytes as an undisturbed one.
"""

import copy
import json
import logging
import math
import time
from pathlib import Path

import safetensors.torch
import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor
from tqdm import trange

from beso import methods, optimizers
from beso.checkpoint import Trained
from beso.data.play import PlayDataset
from beso.data.scaling import Scaling
from beso.data.spec import PlaySpec
from beso.data.windows import Windows
from beso.errors import UserError
from beso.files import replacing
from beso.seeding import integer_seed, torch_generator
from beso.training_config import TrainingJob

log = logging.getLogger(__name__)


def train(
    job: TrainingJob,
    dataset: PlayDataset,
    spec: PlaySpec,
    device: torch.device,
    state_path: Path,
    save_seconds: float = 60.0,
) -> Trained:
    """Train one model, continuing from `state_path` where that file exists.

    The file is rewritten every `save_seconds` and is the caller's to delete.
    """
    # Data
    optimization, model = job.config.optimization, job.config.model
    training_episodes, held_out_episodes = job.split(len(dataset))
    scaling = Scaling.fit(dataset, training_episodes, spec)
    shape = (scaling, model.window, spec.goal_window, device, model.lookahead, model.goal_at_end, job.goal_horizon)
    windows = Windows(dataset, training_episodes, *shape)
    held_out = Windows(dataset, held_out_episodes, *shape)
    validation_seed = (job.root_seed, "validation", job.seed)
    held_out_batch = held_out.sample(job.validation.windows, torch_generator(*validation_seed, device=device))

    # Model, averages, optimizer
    initial = torch_generator(job.root_seed, "initial weights", job.seed)
    method = methods.load(job.method).Method(model, None, spec.sizes, initial).to(device).train()
    method.prepare(windows.actions, integer_seed(job.root_seed, "preparation", job.seed))
    averaged = copy.deepcopy(method).eval().requires_grad_(False)
    parameters, averages = list(method.parameters()), list(averaged.parameters())
    updates = optimizers.make(optimization.optimizer, parameters, optimization.learning_rate, optimization.weight_decay)

    # Resumable state
    draws = torch_generator(job.root_seed, "training", job.seed, device=device)
    loss_sum = torch.zeros((), device=device)
    loop = _LoopState(method, averaged, updates, draws, loss_sum)
    first_step, curve = loop.load(state_path)
    name = f"{job.method} seed {job.seed}"
    if first_step:
        log.info("%s: continuing at step %d", name, first_step)
    saved_at = logged_at = time.monotonic()
    logged_step = first_step

    for step in trange(
        first_step, optimization.steps, initial=first_step, total=optimization.steps, desc=name, disable=None
    ):
        # One update
        rate = optimization.learning_rate_at(step)
        for optimizer in updates:
            for group in optimizer.param_groups:
                group["lr"] = rate
        method.schedule(step / optimization.steps)
        batch = windows.sample(optimization.batch_size, draws)
        with torch.autocast(device.type, torch.bfloat16, enabled=optimization.precision == "bf16"):
            loss = method.loss(batch, draws)
        loss.backward()
        for optimizer in updates:
            optimizer.step()
        method.zero_grad()
        decay = min(optimization.ema_decay, (1 + step) / (10 + step))
        with torch.no_grad():  # otherwise the averages would remember every update
            torch._foreach_lerp_(averages, parameters, 1 - decay)
        loss_sum += loss.detach()

        # Measurement
        done = step + 1
        if done % job.validation.every == 0 or done == optimization.steps:
            since = done - (curve[-1]["step"] if curve else 0)
            with torch.no_grad():  # not inference mode: C-IBC's loss has a gradient within
                held_out_loss = averaged.loss(held_out_batch, torch_generator(*validation_seed, device=device)).item()
            curve.append(
                {
                    "step": done,
                    "training_loss": loss_sum.item() / since,
                    "validation_loss": held_out_loss,
                    "learning_rate": rate,
                }
            )
            loss_sum.zero_()
            if not math.isfinite(curve[-1]["training_loss"]):
                raise UserError(f"{name}: the training loss is not finite after {done} steps; lower learning_rate")
            now = time.monotonic()
            speed = (done - logged_step) / (now - logged_at)
            logged_at, logged_step = now, done
            log.info(
                "%s: step %d/%d, training loss %.4f, validation loss %.4f, %.1f steps/s",
                *(name, done, optimization.steps, curve[-1]["training_loss"], held_out_loss, speed),
            )
        if time.monotonic() - saved_at >= save_seconds:
            loop.save(state_path, done, curve)
            saved_at = time.monotonic()

    weights = {key: value.detach().cpu().contiguous() for key, value in averaged.state_dict().items()}
    return Trained(weights, scaling, curve)


class _LoopState:
    """Saves and restores everything the loop changes, in one safetensors file; numbers go into its header."""

    def __init__(
        self,
        method: torch.nn.Module,
        averaged: torch.nn.Module,
        updates: list[torch.optim.Optimizer],
        draws: torch.Generator,
        loss_sum: Tensor,
    ) -> None:
        self.draws = draws
        names = {id(parameter): name for name, parameter in method.named_parameters()}
        self.parameters = {  # by name: the parameter, and the state of the optimizer that updates it
            names[id(parameter)]: (parameter, optimizer.state)
            for optimizer in updates
            for group in optimizer.param_groups
            for parameter in group["params"]
        }
        self.tensors = {f"method.{k}": v for k, v in method.state_dict().items()}
        self.tensors |= {f"averaged.{k}": v for k, v in averaged.state_dict().items()}
        self.tensors["loss_sum"] = loss_sum

    def save(self, path: Path, step: int, curve: list[dict[str, float]]) -> None:
        tensors = {key: value.contiguous() for key, value in self.tensors.items()}
        for name, (parameter, state) in self.parameters.items():
            for key, value in state[parameter].items():
                tensors[f"optimizer.{name}.{key}"] = value
        tensors["draws"] = self.draws.get_state()
        with replacing(path) as temporary:
            metadata = {"step": str(step), "curve": json.dumps(curve)}
            temporary.write_bytes(safetensors.torch.save(tensors, metadata))

    def load(self, path: Path) -> tuple[int, list[dict[str, float]]]:
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
                # The fused optimizers keep their step count on the parameter's device too.
                state[parameter] = {k.removeprefix(prefix): file.get_tensor(k).to(parameter.device) for k in keys}
            self.draws.set_state(file.get_tensor("draws"))
            metadata = file.metadata()
        return int(metadata["step"]), json.loads(metadata["curve"])
