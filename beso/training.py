"""One training loop for every method: windows by index, EMA with warm-up, checkpoints, exact resume.

The loop's whole state (weights, averages, optimizer, random generator, step, curve) goes to one file now and then; a
run that is killed continues from it and ends with the same bytes as an undisturbed one.
"""

import copy
import logging
import math
import time
from pathlib import Path

import torch
from tqdm import trange

from beso import checkpoint, methods, optimizers
from beso.checkpoint import Trained
from beso.data.play import PlayDataset
from beso.data.scaling import Scaling
from beso.data.spec import PlaySpec
from beso.data.windows import Windows
from beso.errors import UserError
from beso.images import finetuned
from beso.loop_state import LoopState
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
    encoder: Path | None = None,
    teacher: Path | None = None,
) -> Trained:
    """Train one model, continuing from `state_path` where that file exists.

    The file is rewritten every `save_seconds` and is the caller's to delete.

    Args:
        encoder: folder of the encoder that is trained too, where the dataset holds frames.
        teacher: folder of the trained models that this one's teacher, the one of the same seed, is among.
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
    method = methods.load(job.method).Method(model, None, spec.sizes, initial)
    encoding = None
    if dataset.frame_size is not None:
        assert encoder is not None
        method = finetuned.join(method, encoder, dataset, training_episodes)
        encoding = method.encoding
    method = method.to(device).train()
    if teacher is not None:
        method.learn_from(checkpoint.load(teacher, job.seed, None, device).method)
    method.prepare(windows.actions, integer_seed(job.root_seed, "preparation", job.seed))
    averaged = copy.deepcopy(method).eval().requires_grad_(False)
    parameters, averages = list(method.parameters()), list(averaged.parameters())
    updates = optimizers.make(optimization.optimizer, parameters, optimization.learning_rate, optimization.weight_decay)

    # Resumable state
    draws = torch_generator(job.root_seed, "training", job.seed, device=device)
    loss_sum = torch.zeros((), device=device)
    loop = LoopState({"method": method, "averaged": averaged}, updates, draws, loss_sum)
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
            averaged.settle()
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
    return Trained(weights, scaling, curve, encoding)
