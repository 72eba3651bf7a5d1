"""A study: one trained cell, played with several samplings from the same starts and with the same noise."""

from collections import Counter
from typing import Any

import pandas as pd
import torch

from beso import envs, methods
from beso.config import build
from beso.core import checkpoint
from beso.core.noise import BatchNoise
from beso.data.spec import Sizes
from beso.evaluation.rollout import EvaluationJob
from beso.files import write_text
from pipeline import recipes
from pipeline.machine import Machine
from pipeline.recipes import EvaluateRecipe, StudyRecipe
from pipeline.rollouts import evaluation_jobs, play_all


def main(name: str) -> None:
    run_study(recipes.read_study(name), Machine.load())


def run_study(recipe: StudyRecipe, machine: Machine) -> None:
    """Play a cell's episodes with every sampling of a study.

    The rows are those of an evaluation; in front are the changed parameters, and how often an action calls the network.
    """
    description = checkpoint.load_description(recipe.models, recipe.seeds[0])
    model = build(methods.load(recipe.of).Config, description["job"]["config"]["model"], str(recipe.models))
    sizes = envs.spec(recipe.env).sizes
    jobs: list[EvaluationJob] = []
    labels: list[dict[str, Any]] = []
    for changed, sampling in zip(recipe.changes, recipe.samplings, strict=True):
        label = {**changed, "calls": network_calls(recipe.of, model, sampling, sizes)}
        cell = EvaluateRecipe(recipe.env, recipe.method, recipe.of, recipe.seeds, sampling, recipe.evaluation, False)
        of_sampling = evaluation_jobs(cell, machine)
        jobs += of_sampling
        labels += [label] * len(of_sampling)
    rows, _ = play_all(machine, jobs, f"study {recipe.study}", labels)
    write_text(recipe.rows, pd.DataFrame(rows).to_csv(index=False))


def network_calls(method: str, model: Any, sampling: Any, sizes: Sizes) -> int:
    """How often one action calls the policy's network, or that of its networks which it calls most.

    Guidance makes no call more, but calls on pairs of inputs, with and without goal.

    Args:
        model, sampling: configurations of the method.
    """
    draws, calls = torch.Generator().manual_seed(0), Counter[str]()
    policy = methods.load(method).Method(model, sampling, sizes, draws).eval()
    for name, network in policy.named_children():
        network.register_forward_hook(lambda *_, name=name: calls.update([name]))
    with torch.inference_mode():
        observations, actions = torch.zeros(1, 1, sizes.observation), torch.zeros(1, 0, sizes.action)
        goal = torch.zeros(1, sizes.goal_window, sizes.observation)
        policy.act(observations, actions, goal, BatchNoise(1, draws), {})
    return max(calls.values())
