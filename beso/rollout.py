"""Seeded evaluation, batched over environments.

Episodes run in fixed chunks; a chunk steps its environments together and asks the policy once a step for all that are
still running. Start, goal and policy noise of an episode come from generators named after its model seed and number, so
that every method meets the same starts and the number of workers never changes a number.
"""

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from beso import checkpoint, envs, methods
from beso.data import play
from beso.data.scaling import CLIP, Scaling
from beso.data.spec import spec
from beso.evaluation_config import Chunk, EvaluationConfig
from beso.memory import Memory
from beso.noise import EpisodeNoise, Noise
from beso.seeding import generator, integer_seed
from beso.training import pick_device, split
from beso.training_config import TrainingJob


class Agent:
    """A policy with the context of a batch of episodes, in raw units.

    Args:
        method: the policy (see beso.methods.Method), in evaluation mode.
        window: longest context.
        goals: (B, G, observation_size) raw goal states, constant through the episodes.
    """

    def __init__(self, method: Any, window: int, scaling: Scaling, goals: np.ndarray, device: torch.device) -> None:
        self.method, self.window, self.scaling, self.device = method, window, scaling, device
        self.goal = scaling.goals(self._tensor(goals))
        self.observations = self.goal[:, :0]  # (B, up to window, O)
        self.actions: torch.Tensor | None = None  # (B, up to window - 1, A)
        self.memory: Memory = {}

    def _tensor(self, array: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(np.asarray(array, dtype=np.float32)).to(self.device)

    @torch.inference_mode()
    def act(self, observations: np.ndarray, noise: Noise) -> np.ndarray:
        """(B, observation_size) raw observations -> (B, action_size) raw actions."""
        current = self.scaling.observations(self._tensor(observations))
        self.observations = torch.cat([self.observations, current[:, None]], dim=1)[:, -self.window :]
        if self.actions is None:
            self.actions = current.new_empty(len(current), 0, len(self.scaling.action_low))
        action = self.method.act(self.observations, self.actions, self.goal, noise, self.memory).clamp(-CLIP, CLIP)
        history = torch.cat([self.actions, action[:, None]], dim=1)
        self.actions = history[:, max(0, history.shape[1] - (self.window - 1)) :]
        return self.scaling.raw_actions(action).cpu().numpy()

    def keep(self, running: np.ndarray) -> None:
        """Go on with a part of the batch, (B,) booleans."""
        rows = torch.from_numpy(running).to(self.device)
        self.goal, self.observations = self.goal[rows], self.observations[rows]
        if self.actions is not None:
            self.actions = self.actions[rows]
        self.memory = {name: value[rows] for name, value in self.memory.items()}


def evaluate_chunk(
    environment: str,
    data: Path,
    models: Path,
    job: TrainingJob,
    sampling: Any,
    config: EvaluationConfig,
    chunk: Chunk,
    device_name: str,
    film: Callable[[np.ndarray], None] | None = None,
) -> list[dict[str, Any]]:
    """Play the episodes of one chunk with one trained model; a row an episode.

    Args:
        data, models: folders of the play dataset and of the trained models.
        job: the trained model.
        film: called with every picture (H, W, 3) of the chunk's first episode.
    """
    device = pick_device(device_name)
    module, environment_spec = envs.load(environment), spec(environment)
    dataset = play.load(data, environment_spec)
    method, scaling = checkpoint.load(models, job, sampling, environment_spec, device)
    candidates = split(job, len(dataset))[0 if chunk.goals == "training" else 1]

    # Starts and goals
    numbers = range(chunk.first, chunk.last)
    environments = _environments(environment, len(numbers))
    if film:
        environments[0] = _filming_environment(environment)
    start_role, noise_role = f"start, {chunk.goals} goals", f"policy noise, {chunk.goals} goals"
    observations = np.stack(
        [
            env.reset(seed=integer_seed(config.seed, start_role, job.seed, i))[0]
            for env, i in zip(environments, numbers, strict=True)
        ]
    )
    demonstrations = [int(candidates[i % len(candidates)]) for i in numbers]
    goals = []
    for demonstration, observation in zip(demonstrations, observations, strict=True):
        end = dataset.episode_ends[demonstration]
        goals.append(
            module.evaluation_goal(dataset.observations[end - environment_spec.goal_window : end], observation)
        )
    length = methods.context_length(job.config.model, sampling)
    agent = Agent(method, length, scaling, np.stack(goals), device)
    noise = EpisodeNoise([generator(config.seed, noise_role, job.seed, i) for i in numbers], device)

    # Play
    rows: list[dict[str, Any]] = [
        {"seed": job.seed, "goals": chunk.goals, "episode": i, "goal_demonstration": d, "reward": 0.0, "length": 0}
        for i, d in zip(numbers, demonstrations, strict=True)
    ]
    running = np.arange(len(numbers))
    if film:
        film(environments[0].render())
    for _ in range(config.max_actions or module.MAX_ACTIONS):
        actions = agent.act(observations, noise)
        ended = np.zeros(len(running), dtype=bool)
        observations = np.empty((len(running), environment_spec.observation_size))
        for position, index in enumerate(running):
            observation, reward, terminated, truncated, info = environments[index].step(actions[position])
            observations[position], ended[position] = observation, terminated or truncated
            row = rows[index]
            row["reward"] += reward
            row["length"] += 1
            row |= {"info": info, "observation": observation}
            if film and index == 0:
                film(environments[0].render())
        running, observations = running[~ended], observations[~ended]
        if not len(running):
            break
        agent.keep(~ended)
        noise.keep(~ended)

    # Score
    for row, goal in zip(rows, goals, strict=True):
        info, goal_tasks = row.pop("info"), dataset.completed(row["goal_demonstration"])
        row["goal_distance"] = round(module.goal_distance(row.pop("observation"), goal), 6)
        row["reward"] = round(row["reward"], 6)
        row["tasks"] = " ".join(map(str, info["tasks"]))
        row["goal_tasks"] = " ".join(map(str, goal_tasks))
        row["result"] = module.result(info, goal_tasks)
    return rows


def _environments(name: str, count: int) -> list[Any]:
    """Environments of this process, made once: an episode depends on its reset alone."""
    made = _made_environments(name)
    made += [envs.load(name).make() for _ in range(count - len(made))]
    return made[:count]


@functools.cache
def _made_environments(name: str) -> list[Any]:
    return []


@functools.cache
def _filming_environment(name: str) -> Any:
    return envs.load(name).make(render_mode="rgb_array")
