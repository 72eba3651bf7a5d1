"""Trained policies in raw units: `Policy` for one episode at a time, `BatchPolicy` for a batch of them.

    policy = Policy.load("models/block_push/c_beso", seed=1)
    policy.reset(goal)
    action = policy.act(observation)      # in a loop
    print(policy.spec)                    # what goals, observations and actions are

A policy acts as it was evaluated. How that was stands in a file: `evaluation.json` in the model's folder, as archives
and `beso train` have it, or, in a run's folder, `recipes/evaluate/ENV/METHOD.json` for models/ENV/METHOD.

This needs torch, numpy and safetensors, and neither a simulator nor params.yaml.
"""

import logging
from collections.abc import Mapping
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from beso import envs, methods
from beso.checks import finite, numbers
from beso.config import build
from beso.core import checkpoint
from beso.core.device import pick_device
from beso.core.memory import Memory
from beso.core.noise import EpisodeNoise, Noise
from beso.core.seeding import generator
from beso.data.scaling import CLIP
from beso.errors import UserError
from beso.files import from_home, read_json
from beso.interface import PolicySpec
from beso.sampling.weights import Weights, choose

LARGEST = 1e9  # of a raw number; with far larger ones, single precision overflows in a network
EVALUATION = "evaluation.json"  # in a model's folder: `env`, and `sampling` by parameter

log = logging.getLogger(__name__)


class BatchPolicy:
    """A trained policy with the context of a batch of episodes, in raw units.

    Args:
        policy: a trained policy.
        goals: (B, G, observation_size) raw goal states, constant through the episodes; or frames (B, G, H, W, 3), as
            all observations then, if the policy has an encoder of its own.

    Raises:
        UserError: goals have another shape or hold numbers that are not finite.
    """

    def __init__(self, policy: checkpoint.LoadedModel, goals: np.ndarray, device: torch.device) -> None:
        self.method, self.scaling, self.window, self.device = policy.method, policy.scaling, policy.context, device
        self.encode = policy.encode
        encoded = self.encode(goals.reshape(-1, *goals.shape[2:]))
        states = self._tensor("goals", encoded, len(encoded))
        self.goal = self.scaling.scale_goals(states.unflatten(0, goals.shape[:2]))
        self.observations = self.goal[:, :0]  # (B, up to window, O)
        self.actions: torch.Tensor | None = None  # (B, up to window - 1, A)
        self.memory: Memory = {}

    def _tensor(self, what: str, array: Any, count: int) -> torch.Tensor:
        """Raw states (count, observation_size), whole and finite, also as float32."""
        with np.errstate(over="ignore"):
            single = np.asarray(numbers(what, array, (count, self.scaling.observation_size)), dtype=np.float32)
        finite(what, single)
        if (largest := np.abs(single).max(initial=0.0)) > LARGEST:
            raise UserError(f"{what} holds a number of size {largest:g}: must be at most {LARGEST:g}")
        if single.shape[1] <= max(self.scaling.visible):
            raise UserError(f"{what} has {single.shape[1]} columns, expected at least {max(self.scaling.visible) + 1}")
        return torch.from_numpy(single).to(self.device)

    @torch.inference_mode()
    def act(self, observations: np.ndarray, noise: Noise) -> np.ndarray:
        """(B, observation_size) raw observations -> (B, action_size) raw actions.

        Raises:
            UserError: observations have another shape, or they or the actions hold numbers that are not finite.
        """
        raw = self._tensor("observations", self.encode(observations), len(self.goal))
        current = self.scaling.scale_observations(raw)
        self.observations = torch.cat([self.observations, current[:, None]], dim=1)[:, -self.window :]
        if self.actions is None:
            self.actions = current.new_empty(len(current), 0, len(self.scaling.action_low))
        goal = self.scaling.seen_goals(self.goal, self.observations)
        action = self.method.act(self.observations, self.actions, goal, noise, self.memory).clamp(-CLIP, CLIP)
        history = torch.cat([self.actions, action[:, None]], dim=1)
        self.actions = history[:, max(0, history.shape[1] - (self.window - 1)) :]
        raw_actions = self.scaling.raw_actions(action).cpu().numpy()
        finite("the policy's actions", raw_actions)
        return raw_actions

    def keep(self, running: np.ndarray) -> None:
        """Go on with a part of the batch, (B,) booleans."""
        rows = torch.from_numpy(running).to(self.device)
        self.goal, self.observations = self.goal[rows], self.observations[rows]
        if self.actions is not None:
            self.actions = self.actions[rows]
        self.memory = {name: value[rows] for name, value in self.memory.items()}


class Policy:
    """A trained policy that acts in one episode at a time.

    Attributes:
        sampling: how it generates actions, the method's Sampling; None if the method's own default.
        environment: the one that it was evaluated in; None if its folder does not tell.
    """

    def __init__(
        self,
        loaded: checkpoint.LoadedModel,
        device: torch.device,
        sampling: Any = None,
        environment: str | None = None,
    ) -> None:
        self._loaded, self._device = loaded, device
        self.sampling, self.environment = sampling, environment
        self._batch: BatchPolicy | None = None

    @classmethod
    def load(
        cls,
        folder: str | Path,
        seed: int = 1,
        sampling: Mapping[str, Any] | None = None,
        device: str = "auto",
        weights: Weights = "fp32",
    ) -> "Policy":
        """Load a model that `stages.train` wrote.

        Args:
            folder: of the trained cell.
            seed: the model's number.
            sampling: how to generate actions, as in params.yaml under `methods.<name>.sample`; None is as in the
                evaluation, or, where nothing tells how that was (a line in the log says so), the method's default.
            device: "auto", "cpu", "cuda" or one GPU, "cuda:1".
            weights: "fp16" acts faster on a CPU, see beso.sampling.weights.

        Raises:
            UserError: files are missing or damaged, `sampling` is not one for this method, or as weights.choose.
        """
        folder, chosen = from_home(folder), pick_device(device)
        config = checkpoint.config(folder, seed)
        kind = methods.sampling(checkpoint.load_description(folder, seed)["job"]["method"])
        path = _evaluation(folder)
        evaluated = read_json(path) if path else {}
        if sampling is not None:
            chosen_sampling = build(kind, sampling, "sampling")
        elif path:
            chosen_sampling = build(kind, evaluated.get("sampling"), f"{path}: sampling")
        else:
            chosen_sampling = kind.default(config)
            if fields(kind):  # type: ignore[arg-type]
                log.warning("%s does not tell how its policy was sampled when it was evaluated: a default is", folder)
        environment = evaluated.get("env")
        if environment is not None and environment not in envs.names():
            raise UserError(f"{path} is damaged: env = {environment!r} is not one of {', '.join(envs.names())}")
        loaded = checkpoint.load(folder, seed, chosen_sampling, chosen)
        choose(loaded.method, weights)
        if environment is not None and loaded.scaling.observation_size is None:
            size = envs.spec(environment).observation_size
            loaded = replace(loaded, scaling=replace(loaded.scaling, observation_size=size))
        return cls(loaded, chosen, chosen_sampling, environment)

    @property
    def spec(self) -> PolicySpec:
        """What goals, observations and actions are: sizes, order, units. `print` shows it."""
        loaded = self._loaded
        scaling, shape = loaded.scaling, loaded.observation_shape
        masked = {scaling.visible[i] for i in scaling.goal_masked}
        return PolicySpec(
            environment=self.environment,
            observation_shape=shape,
            goal_shape=(loaded.goal_window, *shape),
            action_shape=(len(scaling.action_low),),
            frames=loaded.frame_size is not None,
            interface=envs.interface(self.environment) if self.environment else None,
            seen=scaling.visible,
            seen_of_goals=tuple(i for i in scaling.visible if i not in masked),
            sampling=asdict(self.sampling) if self.sampling else {},
        )

    def reset(self, goal: np.ndarray, seed: int = 0) -> None:
        """Start an episode.

        Args:
            goal: (G, observation_size) raw goal states, or one state; frames (G, H, W, 3) for a policy that has its own
                encoder.
            seed: of the policy's random numbers in this episode, at least 0.

        Raises:
            UserError: the goal has another shape or holds a number that is not finite, or the seed is negative.
        """
        if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
            raise UserError(f"seed = {seed!r}: must be a whole number of at least 0")
        state, window = self._loaded.observation_shape, self._loaded.goal_window
        shapes = [(window, *state)] if window != 1 else [(1, *state), state]
        states = numbers("goal", goal, *shapes)
        self._batch = BatchPolicy(self._loaded, states.reshape(1, -1, *states.shape[-len(state) :]), self._device)
        self._noise = EpisodeNoise([generator(seed, "policy noise")], self._device)

    def act(self, observation: np.ndarray) -> np.ndarray:
        """(observation_size,) raw observation -> (action_size,) raw action.

        Raises:
            UserError: no episode was started; the observation has another shape or holds a number that is not finite.
        """
        if self._batch is None:
            raise UserError("no goal: call reset(goal) before act")
        return self._batch.act(numbers("observation", observation, self._loaded.observation_shape)[None], self._noise)[
            0
        ]


def _evaluation(folder: Path) -> Path | None:
    """The file that tells how the policy of a model's folder is evaluated; None if there is none."""
    whole = folder.absolute()
    places = [folder / EVALUATION]
    if whole.parts[-3:-2] == ("models",):
        places.append(whole.parents[2].joinpath("recipes", "evaluate", *whole.parts[-2:]).with_suffix(".json"))
    return next((place for place in places if place.is_file()), None)
