"""One training loop for every method: windows by index, EMA with warm-up, checkpoints, exact resume.

The loop's whole state (weights, averages, optimizer, random generator, step, curve) goes to one file now and then; a
run that is killed continues from it and ends with the same bytes as an undisturbed one.

On a GPU all data lie there and a step does not wait for it; only measurements and saving do. A seed that does not fill
the GPU may share it with others in one process, each on a stream of its own. That pays where a step costs Python
little, with a CUDA graph; without one, a process each serves better.
"""

import copy
import logging
import math
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import torch
from torch import Tensor
from tqdm import tqdm

from beso import methods
from beso.core import checkpoint
from beso.core.checkpoint import TrainedModel
from beso.core.device import pick_precision
from beso.core.seeding import integer_seed, torch_generator
from beso.core.training_config import TrainingJob
from beso.data.play import PlayDataset
from beso.data.scaling import Scaling
from beso.data.spec import PlaySpec
from beso.data.windows import WindowConfig, Windows
from beso.encoders import finetuned
from beso.errors import UserError
from beso.training import cuda_graph, optimizers
from beso.training.loop_state import LoopState

log = logging.getLogger(__name__)


class Training:
    """One model and everything that its training changes, a step at a time.

    Args:
        state_path: where the state of unfinished training is saved. A state that is there is continued.
        encoder: folder of the encoder that is trained too, where the dataset holds frames.
        teacher: folder of the trained models that this one's teacher, the one of the same seed, is among.
        graph: record the passes of a step as a CUDA graph, on a GPU; not where frames are read in every step.
    """

    def __init__(
        self,
        job: TrainingJob,
        dataset: PlayDataset,
        spec: PlaySpec,
        device: torch.device,
        state_path: Path,
        encoder: Path | None = None,
        teacher: Path | None = None,
        graph: bool = False,
    ) -> None:
        # Data
        self.job, self.device, self._state_path = job, device, state_path
        optimization, model = job.config.optimization, job.config.model
        self._precision = pick_precision(optimization.precision, device)
        training_episodes, held_out_episodes = job.split(len(dataset))
        self.scaling = Scaling.fit(dataset, training_episodes, spec, job.relative_goals)
        config = WindowConfig(
            window=model.window,
            goal_window=spec.goal_window,
            lookahead=model.lookahead,
            goal_horizon=job.goal_horizon,
            final_goals=model.final_goals,
        )
        self.windows = Windows(dataset, training_episodes, self.scaling, config, device)
        held_out = Windows(dataset, held_out_episodes, self.scaling, config, device)
        self._held_out_batch = held_out.sample(job.validation.windows, self._validation_draws())

        # Model, averages, optimizer
        initial = torch_generator(job.root_seed, "initial weights", job.seed)
        method = methods.load(job.method).Method(model, None, spec.sizes, initial)
        self.encoding = None
        if dataset.frame_size is not None:
            assert encoder is not None
            method = finetuned.join(method, encoder, dataset, training_episodes, self.scaling)
            self.encoding = method.encoding
        self.method = method.to(device).train()
        if teacher is not None:
            self.method.learn_from(checkpoint.load(teacher, job.seed, None, device).method)
        self.method.prepare(self.windows.actions, integer_seed(job.root_seed, "preparation", job.seed))
        self.averaged = copy.deepcopy(self.method).eval().requires_grad_(False)
        self._parameters, self._averages = list(self.method.parameters()), list(self.averaged.parameters())
        self._updates = optimizers.make(
            optimization.optimizer, self._parameters, optimization.learning_rate, optimization.weight_decay
        )

        # Resumable state
        self.draws = torch_generator(job.root_seed, "training", job.seed, device=device)
        self._loss_sum = torch.zeros((), device=device)
        modules = {"method": self.method, "averaged": self.averaged}
        self._loop = LoopState(modules, self._updates, self.draws, self._loss_sum)
        self.done, self.curve = self._loop.load(state_path)
        self.name = f"{job.method} seed {job.seed}"
        if self.done:
            log.info("%s: continuing at step %d", self.name, self.done)
        self._logged_at, self._logged_step = time.monotonic(), self.done

        # Work of several models on one GPU may overlap only on different streams.
        self._stream = torch.cuda.Stream(device) if device.type == "cuda" else None
        if self._stream is not None:
            self._stream.wait_stream(torch.cuda.current_stream(device))
        self._graph = graph and device.type == "cuda" and self.encoding is None
        self._recorded: Callable[[], Tensor] | None = None

    @property
    def finished(self) -> bool:
        """Whether all steps are done."""
        return self.done == self.job.config.optimization.steps

    def step(self) -> None:
        """One update of weights and averages, without waiting for the GPU; a measurement where one is due."""
        optimization = self.job.config.optimization
        with torch.cuda.stream(self._stream):
            rate = optimization.learning_rate_at(self.done)
            for optimizer in self._updates:
                for group in optimizer.param_groups:
                    group["lr"] = rate
            changed = self.method.schedule(self.done / optimization.steps)
            if self._graph and (changed or self._recorded is None):
                self._recorded = cuda_graph.record(self._passes, self.draws)
            loss = (self._recorded or self._passes)()
            for optimizer in self._updates:
                optimizer.step()
            decay = min(optimization.ema_decay, (1 + self.done) / (10 + self.done))
            with torch.no_grad():  # otherwise the averages would remember every update
                torch._foreach_lerp_(self._averages, self._parameters, 1 - decay)
            self._loss_sum += loss
            self.done += 1
            if self.done % self.job.validation.every == 0 or self.finished:
                self._measure(rate)

    def _passes(self) -> Tensor:
        """The loss of a new batch, and its gradients."""
        optimization = self.job.config.optimization
        self.method.zero_grad()
        batch = self.windows.sample(optimization.batch_size, self.draws)
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self._precision == "bf16"):
            loss = self.method.loss(batch, self.draws)
        loss.backward()
        return loss.detach()

    def _validation_draws(self) -> torch.Generator:
        return torch_generator(self.job.root_seed, "validation", self.job.seed, device=self.device)

    def _measure(self, rate: float) -> None:
        """Add a row to the curve.

        Raises:
            UserError: a loss is not finite.
        """
        since = self.done - (self.curve[-1]["step"] if self.curve else 0)
        self.averaged.settle()
        with torch.no_grad():  # not inference mode: C-IBC's loss has a gradient within
            held_out_loss = self.averaged.loss(self._held_out_batch, self._validation_draws()).item()
        training_loss = self._loss_sum.item() / since
        self.curve.append(
            {
                "step": self.done,
                "training_loss": training_loss,
                "validation_loss": held_out_loss,
                "learning_rate": rate,
            }
        )
        self._loss_sum.zero_()
        for kind, loss in (("training", training_loss), ("validation", held_out_loss)):
            if not math.isfinite(loss):
                raise UserError(f"{self.name}: the {kind} loss is {loss} after {self.done} steps; lower learning_rate")
        now = time.monotonic()
        speed = (self.done - self._logged_step) / (now - self._logged_at)
        self._logged_at, self._logged_step = now, self.done
        steps = self.job.config.optimization.steps
        log.info(
            "%s: step %d/%d, training loss %.4f, validation loss %.4f, %.1f steps/s",
            *(self.name, self.done, steps, training_loss, held_out_loss, speed),
        )

    def save(self) -> None:
        """Write the state, atomically; the file is the caller's to delete."""
        with torch.cuda.stream(self._stream):
            self._loop.save(self._state_path, self.done, self.curve)

    def result(self) -> TrainedModel:
        """The model as it is now.

        Raises:
            UserError: a weight is not finite.
        """
        with torch.cuda.stream(self._stream):
            weights = {key: value.detach().cpu().contiguous() for key, value in self.averaged.state_dict().items()}
        for key, value in weights.items():
            if not value.isfinite().all():
                raise UserError(f"{self.name}: {key} has weights that are not finite; lower learning_rate")
        return TrainedModel(weights, self.scaling, self.curve, self.encoding, self._precision)


def side_by_side(
    trainings: Iterable[Training], save_seconds: float = 60.0, until: float = math.inf
) -> Iterator[Training]:
    """Train several models in turns, a step each, and yield each that is finished.

    Every model's bytes are those that it would have alone. All states are saved every `save_seconds`, and at the time
    `until` (of time.monotonic), when this ends.
    """
    waiting = list(trainings)
    total = sum(training.job.config.optimization.steps for training in waiting)
    saved_at = time.monotonic()
    with tqdm(total=total, initial=sum(t.done for t in waiting), desc=_names(waiting), disable=None) as progress:
        while waiting:
            for training in waiting:
                if not training.finished:
                    training.step()
                    progress.update()
            now = time.monotonic()
            if now >= until or now - saved_at >= save_seconds:
                for training in waiting:
                    training.save()
                saved_at = time.monotonic()
            yield from (training for training in waiting if training.finished)
            waiting = [training for training in waiting if not training.finished]
            if now >= until:
                return


def _names(trainings: list[Training]) -> str:
    return ", ".join(training.name for training in trainings)


def train(
    job: TrainingJob,
    dataset: PlayDataset,
    spec: PlaySpec,
    device: torch.device,
    state_path: Path,
    save_seconds: float = 60.0,
    encoder: Path | None = None,
    teacher: Path | None = None,
) -> TrainedModel:
    """Train one model, continuing from `state_path` where that file exists. Arguments as for `Training`."""
    (finished,) = side_by_side([Training(job, dataset, spec, device, state_path, encoder, teacher)], save_seconds)
    return finished.result()
