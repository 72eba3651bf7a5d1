"""Seeded evaluation, batched over environments.

Episodes run in fixed chunks; a chunk steps its environments together and asks the policy once a step for all that are
still running. Starts and goals are made beforehand (see trials.py), so every method meets the same. The policy noise of
an episode comes from a generator named after its model seed and number. So the number of workers changes no number.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from beso import envs
from beso.core import checkpoint
from beso.core.device import pick_device
from beso.core.noise import EpisodeNoise
from beso.core.seeding import generator
from beso.data import store
from beso.data.play import read_digest
from beso.envs.protocol import Outcome, Trial
from beso.errors import UserError
from beso.evaluation import trials
from beso.evaluation.config import Chunk, EvaluationConfig
from beso.policy import BatchPolicy

Row = dict[str, Any]
Film = Callable[[np.ndarray], None]
Witness = Callable[[Row, Outcome], None]


@dataclass(frozen=True)
class EvaluationJob:
    """One trained model to be evaluated.

    Attributes:
        environment: its name.
        data, trials, models: folders of the play data, of the episodes and of the trained models.
        seed: the trained model's number.
        sampling: how it generates actions.
        config: number of episodes, goals, seed.
        device: name of the device.
    """

    environment: str
    data: Path
    trials: Path
    models: Path
    seed: int
    sampling: Any
    config: EvaluationConfig
    device: str


def evaluate(
    job: EvaluationJob, chunks: Sequence[Chunk], film: Film | None = None, witness: Witness | None = None
) -> list[list[Row]]:
    """Play the episodes of some chunks with one trained model; for each chunk, a row an episode.

    Args:
        film: called with every picture (H, W, 3) of each chunk's first episode.
        witness: called with every episode's row and outcome.

    Raises:
        UserError: trials or models are missing or damaged.
    """
    device, protocol = pick_device(job.device), envs.evaluation(job.environment)
    config = job.config
    all_trials = trials.load(job.trials)
    data = checkpoint.load_description(job.models, job.seed)["data"]
    if (job.data / store.META).is_file() and data != read_digest(job.data):  # an archive has no play data
        raise UserError(f"{job.models}, seed {job.seed}, was trained on other play data than {job.data}; train again")
    policy = checkpoint.load(job.models, job.seed, job.sampling, device)
    frozen, own = protocol.encoder(job.data, device), policy.encode  # one of them, or both, leave observations alone
    policy = replace(policy, encode=lambda observations: own(frozen(observations)))
    # Made once: an episode depends on its reset alone.
    environments = [protocol.make() for _ in range(max(chunk.last - chunk.first for chunk in chunks))]
    if film:
        environments[0].close()
        environments[0] = protocol.make(render_mode="rgb_array")
    played = []
    try:
        for chunk in chunks:
            numbers = range(chunk.first, chunk.last)
            chosen = trials.pick(all_trials, chunk.goals, job.seed, numbers)
            role = f"policy noise, {chunk.goals} goals"
            noise = EpisodeNoise([generator(config.seed, role, job.seed, i) for i in numbers], device)
            outcomes = play_chunk(chosen, environments, policy, noise, device, config.max_actions, film)
            rows = []
            for i, trial, outcome in zip(numbers, chosen, outcomes, strict=True):
                row = {"seed": job.seed, "goals": chunk.goals, "episode": i}
                rows.append({**row, **trial.labels, **protocol.score(trial, outcome)})
                if witness:
                    witness(rows[-1], outcome)
            played.append(rows)
    finally:
        for environment in environments:
            environment.close()
    return played


def play_chunk(
    chosen: list[Trial],
    environments: list[gymnasium.Env],
    policy: checkpoint.LoadedModel,
    noise: EpisodeNoise,
    device: Any,
    max_actions: int | None,
    film: Film | None = None,
) -> list[Outcome]:
    """Play the chosen trials side by side: reset, act, step, until all have ended."""
    outcomes = []
    for trial, environment in zip(chosen, environments, strict=False):
        observation, info = environment.reset(seed=trial.seed, options=trial.options)
        outcomes.append(Outcome(0.0, 0, observation, info, info["goal"], observation))
    agent = BatchPolicy(policy, np.stack([outcome.goal for outcome in outcomes]), device)
    limits = [min(trial.limit, max_actions or trial.limit) for trial in chosen]
    _show(film, environments[0])
    running = np.arange(len(chosen))
    while len(running):
        actions = agent.act(np.stack([outcomes[i].observation for i in running]), noise)
        ended = np.zeros(len(running), dtype=bool)
        for position, index in enumerate(running):
            outcome = outcomes[index]
            observation, reward, terminated, truncated, info = environments[index].step(actions[position])
            outcome.observation, outcome.info = observation, info
            outcome.reward += float(reward)
            outcome.length += 1
            ended[position] = terminated or truncated or outcome.length == limits[index]
            if index == 0:
                _show(film, environments[0])
        running = running[~ended]
        agent.keep(~ended)
        noise.keep(~ended)
    return outcomes


def _show(film: Film | None, environment: gymnasium.Env) -> None:
    if film:
        picture: Any = environment.render()
        film(picture)
