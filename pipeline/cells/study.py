"""A study: one trained cell, played with several samplings from the same starts and with the same noise."""

from collections import Counter
from dataclasses import replace
from typing import Any

import pandas as pd
import torch

from beso import envs, methods
from beso.data.spec import Sizes
from beso.files import write_text
from beso.noise import BatchNoise
from beso.rollout import EvaluationJob
from pipeline import paths
from pipeline.cells.evaluation import evaluation_jobs, play_all
from pipeline.params import Params


def run_study(params: Params, name: str) -> None:
    """Play a cell's episodes with every sampling of a study.

    The rows are those of an evaluation; in front are the changed parameters, and how often an action calls the network.
    """
    samplings = params.samplings(name)
    study, goals = params.studies[name], params.goals(name)
    model, sizes = params.methods[study.method].train[study.env].model, envs.spec(study.env).sizes
    jobs: list[EvaluationJob] = []
    labels: list[dict[str, Any]] = []
    for changed, sampling in samplings:
        label = {**changed, "calls": network_calls(study.of, model, sampling, sizes)}
        for job in evaluation_jobs(params, study.env, study.method, sampling):
            jobs.append(replace(job, config=replace(job.config, goals=goals, rollouts=study.rollouts)))
            labels.append(label)
    rows, _ = play_all(params, jobs, f"study {name}", labels)
    write_text(paths.study(name), pd.DataFrame(rows).to_csv(index=False))


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
