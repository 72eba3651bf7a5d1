"""Evaluate a policy of your own on the episodes that the archived C-BESO was evaluated on.

    python examples/evaluate_own_policy.py          # in the repository's root

A policy is anything with `reset(goal)` and `act(observation)`. The episodes' starts and goals lie in the archive. The
scores are the paper's: the reward counts blocks in any target, the result the pairs that the goal asks for.
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from beso import envs
from beso.envs.protocol import Outcome
from beso.evaluation import trials
from beso.policy import Policy

ARCHIVE, ENVIRONMENT = Path("reports/published/cpu"), "block_push"


class Own:
    """Wanders at random. Put your policy here."""

    def reset(self, goal: np.ndarray) -> None:
        """Take the goal, which this one does not look at."""
        self.draws = np.random.default_rng(0)

    def act(self, observation: np.ndarray) -> np.ndarray:
        """A small step in any direction, metres."""
        return self.draws.uniform(-0.03, 0.03, 2)


parser = argparse.ArgumentParser()
parser.add_argument("--episodes", type=int, default=5)
numbers = range(parser.parse_args().episodes)
protocol = envs.evaluation(ENVIRONMENT)
environment = protocol.make()
chosen = trials.pick(trials.load(ARCHIVE / "data/trials" / ENVIRONMENT), "training", 1, numbers)
policies: dict[str, Any] = {"own": Own(), "C-BESO": Policy.load(ARCHIVE / "models" / ENVIRONMENT / "c_beso")}
for name, policy in policies.items():
    for number, trial in zip(numbers, chosen, strict=True):
        observation, info = environment.reset(seed=trial.seed, options=trial.options)
        policy.reset(info["goal"])
        outcome, ended = Outcome(0.0, 0, observation, info, info["goal"], observation), False
        while not ended and outcome.length < trial.limit:
            action = policy.act(outcome.observation)
            outcome.observation, reward, terminated, truncated, outcome.info = environment.step(action)
            outcome.reward, outcome.length = outcome.reward + float(reward), outcome.length + 1
            ended = terminated or truncated
        print(name, number, protocol.score(trial, outcome))
