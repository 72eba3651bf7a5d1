import dataclasses
import json
import shutil

import numpy as np
import pytest
import safetensors.torch
import torch

from beso import methods
from beso.config import build
from beso.core import checkpoint
from beso.core.noise import EpisodeNoise
from beso.data.scaling import Scaling
from beso.errors import UserError
from beso.policy import Policy

CPU = torch.device("cpu")


@pytest.fixture
def sampling(small_models):
    """sampling(job, changes) -> how the job's method generates actions in these tests."""

    def sampling(job, **changes):
        return build(methods.sampling(job.method), {**small_models[job.method][1], **changes}, "sampling")

    return sampling


@pytest.fixture
def save(dataset, spec, make_job, sampling, tmp_path):
    """save(job) -> the policy that was saved as a checkpoint in tmp_path."""

    def save(job):
        generator = torch.Generator().manual_seed(0)
        method = methods.load(job.method).Method(job.config.model, sampling(job), spec.sizes, generator)
        weights = {key: value.detach().clone() for key, value in method.state_dict().items()}
        scaling = Scaling.fit(dataset, np.arange(3), spec)
        curve = [{"step": 8, "training_loss": 0.5}]
        checkpoint.save(tmp_path, job, spec.sizes, checkpoint.TrainedModel(weights, scaling, curve), "digest")
        return method.eval(), scaling

    return save


@pytest.fixture
def load(sampling, tmp_path):
    def load(job, **changes):
        checkpoint.check(tmp_path, job)
        return checkpoint.load(tmp_path, job.seed, sampling(job, **changes), CPU)

    return load


def refused(message, function, *arguments):
    with pytest.raises(UserError, match=message) as caught:
        function(*arguments)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize("name", methods.names())
def test_a_loaded_policy_acts_like_the_saved_one(save, load, make_job, name):
    job = make_job(name)
    saved, scaling = save(job)
    loaded = load(job)
    assert loaded.scaling == scaling
    assert loaded.context == job.config.model.context
    assert not loaded.method.training
    window = job.config.model.window
    generator = torch.Generator().manual_seed(1)
    observations, actions, goal = (
        torch.randn(shape, generator=generator) for shape in ((2, window, 10), (2, window - 1, 2), (2, 1, 10))
    )
    with torch.inference_mode():
        results = [
            policy.act(observations, actions, goal, EpisodeNoise([np.random.default_rng(i) for i in range(2)]), {})
            for policy in (saved, loaded.method)
        ]
    assert torch.equal(*results)


def test_two_saves_are_the_same_bytes_without_time_or_place(save, make_job, tmp_path):
    job = make_job()
    save(job)
    first = [path.read_bytes() for path in checkpoint.paths(tmp_path, job.seed)]
    save(job)
    assert [path.read_bytes() for path in checkpoint.paths(tmp_path, job.seed)] == first
    assert str(tmp_path).encode() not in b"".join(first)


def test_the_description_holds_job_data_scaling_and_curve(save, make_job, tmp_path):
    job = make_job()
    _, scaling = save(job)
    description = checkpoint.load_description(tmp_path, job.seed)
    assert description["job"] == json.loads(json.dumps(dataclasses.asdict(job)))
    assert description["data"] == "digest"
    assert build(Scaling, description["scaling"], "scaling") == scaling
    assert description["curve"] == [{"step": 8, "training_loss": 0.5}]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"learning_rate": 2e-3}, r"config\.optimization\.learning_rate is 0\.001 there and 0\.002 here"),
        ({"optimizer": "adamw"}, r"config\.optimization\.optimizer is 'adam' there and 'adamw' here"),
        ({"method": "cfg_beso"}, r"goal_dropout is None there and 0\.2 here"),
        ({"every": 5}, r"validation\.every is 3 there and 5 here"),
    ],
)
def test_a_checkpoint_of_another_configuration_is_refused_with_the_key(save, load, make_job, changes, message):
    save(make_job())
    refused(
        rf"seed1\.json is a checkpoint of another configuration: .*{message}; train again", load, make_job(**changes)
    )


def test_sampling_may_change_after_training(save, load, make_job):
    job = make_job()
    save(job)
    policy = load(job, sampler="heun", steps=7, context_length=2)
    assert policy.method.sampling.sampler == "heun"
    assert len(policy.method.sampling.sigmas()) == 8
    assert policy.context == 2


def test_a_missing_model_is_refused(load, make_job, save, tmp_path):
    refused(r"seed1\.json is missing: train this model first", load, make_job())
    save(make_job())
    checkpoint.paths(tmp_path, 1)[0].unlink()
    refused(r"seed1\.safetensors is missing or damaged", load, make_job())


def test_the_model_of_another_seed_is_refused(save, load, make_job, tmp_path):
    save(make_job(seed=1))
    for here, there in zip(checkpoint.paths(tmp_path, 1), checkpoint.paths(tmp_path, 2), strict=True):
        shutil.copy(here, there)
    refused("seed is 1 there and 2 here", load, make_job(seed=2))


@pytest.mark.parametrize("keep", [0, 4, 200, -10])
def test_truncated_weights_are_refused(save, load, make_job, tmp_path, keep):
    save(make_job())
    weights = checkpoint.paths(tmp_path, 1)[0]
    weights.write_bytes(weights.read_bytes()[:keep])
    refused(r"seed1\.safetensors is missing or damaged", load, make_job())


def test_weights_that_are_no_safetensors_are_never_unpickled(save, load, make_job, tmp_path):
    save(make_job())
    torch.save({"weights": torch.zeros(3)}, checkpoint.paths(tmp_path, 1)[0])
    refused(r"seed1\.safetensors is missing or damaged", load, make_job())


def test_a_damaged_description_is_refused(save, load, make_job, tmp_path):
    save(make_job())
    description = checkpoint.paths(tmp_path, 1)[1]
    description.write_text(description.read_text()[:100])
    refused(r"seed1\.json", load, make_job())


def test_weights_of_another_network_are_refused(save, load, make_job, tmp_path):
    save(make_job())
    weights = checkpoint.paths(tmp_path, 1)[0]
    weights.write_bytes(safetensors.torch.save({"other": torch.zeros(3)}))
    refused(r"seed1\.safetensors", load, make_job())


def described(folder, job, change):
    path = checkpoint.paths(folder, job.seed)[1]
    description = json.loads(path.read_text())
    change(description)
    path.write_text(json.dumps(description))


def grown(description, key, value):
    description["job"]["config"]["model"]["transformer"][key] = value


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d["sizes"].update(observation=10**9), "its sizes are not those of its scaling"),
        (lambda d: d["sizes"].update(goal_window=10**12), "its weights are not those of a c_beso"),
        (lambda d: d["sizes"].update(goal_window="1"), "its sizes are not those of its scaling"),
        (lambda d: d.update(sizes=[10, 2, 1]), "its sizes are not those of its scaling"),
        (lambda d: grown(d, "width", 2**14), "its weights are not those of a c_beso"),
        (lambda d: grown(d, "layers", 1000), "its weights are not those of a c_beso"),
        (lambda d: grown(d, "width", 2**40), "width = 1099511627776: must be at most 32768"),
        (lambda d: grown(d, "layers", 10**9), "layers = 1000000000: must be at most 1000"),
        (lambda d: d.update(job=5), "its job has no method and model"),
        (lambda d: d["job"].update(method=["c_beso"]), "method .* is not one of"),
        (lambda d: d["scaling"]["mean"].__setitem__(0, float("nan")), r"scaling.mean\[0\] = nan: expected a finite"),
        (lambda d: d["scaling"]["std"].__setitem__(0, 0.0), "std must be above 0"),
        (lambda d: d["scaling"]["mean"].pop(), "visible, mean and std must have equal lengths"),
        (lambda d: d["scaling"].update(observation_size=4), "visible must be columns of observations"),
    ],
)
def test_a_description_with_wrong_sizes_is_refused_without_building_it(save, make_job, tmp_path, change, message):
    job = make_job()
    save(job)
    described(tmp_path, job, change)
    refused(message, checkpoint.load, tmp_path, job.seed, None, CPU)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_weights_that_are_not_finite_are_refused(save, make_job, tmp_path, value):
    job = make_job("gcbc")
    save(job)
    path = checkpoint.paths(tmp_path, job.seed)[0]
    weights = safetensors.torch.load_file(path)
    name = min(weights)
    weights[name].view(-1)[0] = value
    safetensors.torch.save_file(weights, path)
    refused(f"{name} holds numbers that are not finite", checkpoint.load, tmp_path, job.seed, None, CPU)


def test_weights_of_another_precision_are_refused(save, make_job, tmp_path):
    job = make_job("gcbc")
    save(job)
    path = checkpoint.paths(tmp_path, job.seed)[0]
    weights = {name: value.bfloat16() for name, value in safetensors.torch.load_file(path).items()}
    safetensors.torch.save_file(weights, path)
    refused("its weights are not those of a gcbc", checkpoint.load, tmp_path, job.seed, None, CPU)


def test_a_model_of_an_earlier_version_does_not_tell_its_observations_width(save, make_job, tmp_path):
    job = make_job("gcbc")
    save(job)
    described(tmp_path, job, lambda d: d["scaling"].pop("observation_size"))
    policy = Policy.load(tmp_path, job.seed, device="cpu")
    policy.reset(np.zeros(16))
    policy.act(np.zeros(16))
    refused("observations has 9 columns, expected at least 10", policy.act, np.zeros(9))
