"""A small play dataset and small training jobs, shared by the tests of the library."""

import math

import numpy as np
import pytest
import torch

from beso import envs, methods
from beso.config import build
from beso.core import checkpoint
from beso.core.training_config import OptimizationConfig, TrainingConfig, TrainingJob, ValidationConfig
from beso.data.play import Episode, assemble
from beso.training import loop as training

# The smallest sensible model of every method, as it would stand in params.yaml, and how it generates actions.
TRANSFORMER = {
    "width": 32,
    "layers": 2,
    "heads": 2,
    "window": 3,
    "attention_dropout": 0.1,
    "residual_dropout": 0.1,
    "conditioning": "sequential",
}
DIFFUSION = {
    "sigma_data": 0.5,
    "sigma_min": 0.05,
    "sigma_max": 1.0,
    "density": "log_logistic",
    "location": -0.6931471805599453,
    "scale": 0.5,
    "action_range": 1.0,
}
SAMPLING = {
    "sampler": "ddim",
    "schedule": "exponential",
    "steps": 3,
    "sigma_min": 0.05,
    "sigma_max": 1.0,
    "context": "clean",
    "context_length": None,
}
MODELS = {
    "gcbc": {"width": 32, "layers": 2, "dropout": 0.1},
    "c_beso": {"transformer": TRANSFORMER, "final_goals": 0.0, "diffusion": DIFFUSION},
    "cfg_beso": {
        "transformer": TRANSFORMER,
        "final_goals": 0.0,
        "diffusion": DIFFUSION,
        "goal_dropout": 0.2,
        "goal_dropout_of": "goal",
        "goal_dropout_from": 0.0,
        "null_goal": "learned",
    },
    "c_ibc": {"width": 32, "layers": 2, "counter_examples": 8, "energy_penalty": 0.005, "gradient_penalty": 1.0},
    "ril": {"width": 32, "layers": 2, "horizon": 4},
    "lmp": {
        "window": 4,
        "plan": 4,
        "recognition_width": 16,
        "recognition_layers": 1,
        "recognition_heads": 2,
        "recognition_dropout": 0.1,
        "prior_width": 32,
        "prior_layers": 2,
        "decoder_width": 32,
        "decoder_layers": 2,
        "decoder_dropout": 0.1,
        "mixtures": 3,
        "classes": 16,
        "kl_beta": 0.01,
    },
    "c_bet": {
        "width": 32,
        "layers": 2,
        "heads": 2,
        "window": 3,
        "dropout": 0.1,
        "bins": 4,
        "offset_weight": 10.0,
    },
    "cx_diff": {
        "transformer": TRANSFORMER,
        "final_goals": 0.0,
        "diffusion_steps": 5,
        "beta_min": 1e-4,
        "beta_max": 0.7,
    },
    "distilled": {
        "transformer": TRANSFORMER,
        "final_goals": 0.0,
        "diffusion": DIFFUSION,
        "steps": 2,
        "teacher_steps": 3,
    },
}
TEACHERS = {"distilled": "c_beso"}  # whose models a method learns from, where it is not play data
SAMPLINGS = {
    "gcbc": {},
    "c_beso": SAMPLING,
    "cfg_beso": {**SAMPLING, "guidance_scale": 2.0},
    "c_ibc": {"candidates": 16, "iterations": 3, "noise_scale": 0.3, "noise_shrink": 0.5},
    "ril": {"replan": 2},
    "lmp": {"replan": 2},
    "c_bet": {"context_length": None},
    "cx_diff": {"steps": None, "extra_steps": 2, "context_length": None},
    "distilled": {"context_length": None},
}
OPTIMIZATION = {
    "steps": 8,
    "batch_size": 4,
    "optimizer": "adam",
    "learning_rate": 1e-3,
    "weight_decay": 0.01,
    "schedule": "cosine",
    "ema_decay": 0.9,
    "precision": "fp32",
}


@pytest.fixture
def spec():
    return envs.spec("block_push")


@pytest.fixture
def small_models():
    """(model, sampling) of every method, as plain mappings."""
    return {name: (MODELS[name], SAMPLINGS[name]) for name in MODELS}


@pytest.fixture
def teacher_of(make_job, dataset, spec, tmp_path_factory):
    """teacher_of(job) -> the folder of a trained teacher of this job's seed; None where a method has none."""

    def train(job):
        if job.method not in TEACHERS:
            return None
        folder, teaching = tmp_path_factory.mktemp("teacher"), make_job(TEACHERS[job.method], seed=job.seed)
        trained = training.train(teaching, dataset, spec, torch.device("cpu"), folder / "state", math.inf)
        checkpoint.save(folder, teaching, spec.sizes, trained, "data")
        return folder

    return train


def random_episode(steps, spec, rng):
    """Smooth random paths; two tasks completed, the later task number first."""
    tasks = np.zeros((steps, len(spec.tasks)))
    tasks[steps // 3, 2] = tasks[2 * steps // 3, 1] = 1
    return Episode(
        0.1 * rng.standard_normal((steps, spec.observation_size)).cumsum(axis=0),
        0.03 * np.sin(np.arange(steps)[:, None] / 5 + rng.uniform(0, 6, spec.action_size)),
        tasks,
    )


@pytest.fixture
def make_dataset(spec):
    """make_dataset(lengths, seed) -> a dataset with episodes of these lengths."""

    def make(lengths=(12, 15, 9, 20, 11, 14), seed=0):
        rng = np.random.default_rng(seed)
        return assemble([random_episode(n, spec, rng) for n in lengths], spec, {"source": "random paths"})

    return make


@pytest.fixture
def dataset(make_dataset):
    return make_dataset()


@pytest.fixture
def make_job(small_models):
    """make_job(method, model={}, every=3, seed=1, **optimization changes) -> a training job of a few steps."""

    def make(method="c_beso", model=None, every=3, seed=1, **optimization):
        values = {**small_models[method][0], **(model or {})}
        config = TrainingConfig(
            build(methods.load(method).Config, values, "model"),
            build(OptimizationConfig, {**OPTIMIZATION, **optimization}, "optimization"),
        )
        return TrainingJob(
            method=method,
            config=config,
            validation=ValidationConfig(every, windows=6),
            train_fraction=0.7,
            goal_horizon=None,
            relative_goals=False,
            root_seed=0,
            seed=seed,
        )

    return make
