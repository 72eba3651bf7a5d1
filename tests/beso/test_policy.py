"""Whatever is handed to a policy, it acts in finite numbers or says in one line why it cannot."""

import logging
from dataclasses import asdict, replace

import numpy as np
import pytest
import safetensors.torch
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from beso.core import checkpoint
from beso.core.checkpoint import LoadedModel
from beso.data.scaling import Scaling
from beso.data.spec import Sizes
from beso.errors import UserError
from beso.files import write_json
from beso.methods import c_beso, gcbc
from beso.policy import EVALUATION, Policy

WIDTH, CPU = 6, torch.device("cpu")
SIZES = Sizes(observation=4, action=2, goal_window=1)
SCALING = Scaling((0, 1, 3, 4), (2,), (0.0,) * 4, (0.1,) * 4, (-0.1,) * 2, (0.1,) * 2, WIDTH)
METHOD = gcbc.Method(gcbc.Config(8, 1, 0.0), None, SIZES, torch.Generator().manual_seed(0)).eval()
GOOD = np.zeros(WIDTH)

handed = st.one_of(
    arrays.arrays(
        dtype=st.one_of(arrays.floating_dtypes(), arrays.integer_dtypes(), arrays.complex_number_dtypes()),
        shape=st.one_of(st.just((WIDTH,)), arrays.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=WIDTH + 1)),
    ),
    st.lists(st.one_of(st.floats(), st.integers(), st.text(max_size=3), st.none()), min_size=WIDTH, max_size=WIDTH),
    st.dictionaries(st.text(max_size=3), st.floats(), max_size=2),
    st.none(),
)


def attempt(function, *arguments):
    """What a function returns, and what it says where it refuses."""
    try:
        return function(*arguments), ""
    except UserError as error:
        return None, str(error)


@settings(max_examples=80, deadline=None)
@given(value=handed)
def test_a_policy_acts_in_finite_numbers_or_says_what_is_wrong(value):
    policy = Policy(LoadedModel(METHOD, SCALING, 1), CPU)
    policy.reset(GOOD)
    action, message = attempt(policy.act, value)
    assert message.startswith("observation") if action is None else np.isfinite(action).all()
    assert len(message.splitlines()) <= 1
    _, message = attempt(policy.reset, value)
    if not message:
        assert np.isfinite(policy.act(GOOD)).all()
    assert message == "" or message.startswith("goal")
    assert len(message.splitlines()) <= 1


def test_numbers_that_would_overflow_are_named():
    policy = Policy(LoadedModel(METHOD, SCALING, 1), CPU)
    policy.reset(GOOD)
    for value in ([0.0, -3.4e37, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1e10, 0.0, 0.0]):
        _, message = attempt(policy.act, value)
        assert message == f"observations holds a number of size {max(map(abs, value)):g}: must be at most 1e+09"


@pytest.mark.parametrize("relative", [False, True])
def test_a_policy_gets_the_goal_or_what_is_still_to_change(relative):
    """Of a context of two states, the first; the masked dimension of a goal is zero."""

    class Noted:
        def __init__(self):
            self.goals = []

        def act(self, observations, actions, goal, noise, memory):
            self.goals.append(goal[0, 0])
            return torch.zeros(1, 2)

    method, state = Noted(), np.arange(WIDTH) / 100
    policy = Policy(LoadedModel(method, replace(SCALING, relative_goals=relative), 2), CPU)
    policy.reset(3 * state)
    for i in range(3):
        policy.act(i * state)
    scaled = torch.tensor([0.0, 0.1, 0.0, 0.4])
    for goal, first in zip(method.goals, (0, 0, 1), strict=True):
        assert torch.allclose(goal, (3 - first if relative else 3) * scaled)


@pytest.fixture
def folder(make_job, spec, tmp_path):
    """A C-BESO of block push in a run's folder, untrained."""
    job, folder = make_job("c_beso"), tmp_path / "models/block_push/c_beso"
    method = c_beso.Method(job.config.model, None, spec.sizes, torch.Generator().manual_seed(0))
    n, a = len(spec.visible), spec.action_size
    scaling = Scaling(spec.visible, spec.goal_masked, (0.0,) * n, (1.0,) * n, (-1.0,) * a, (1.0,) * a)
    checkpoint.save(folder, job, spec.sizes, checkpoint.TrainedModel(method.state_dict(), scaling, []), "digest")
    return folder


def test_a_policy_acts_as_it_was_evaluated_unless_told_otherwise(folder, small_models, tmp_path, caplog):
    own = small_models["c_beso"][1]
    with caplog.at_level(logging.WARNING):
        default = Policy.load(folder, device="cpu")
    assert "does not tell how its policy was sampled" in caplog.text
    caplog.clear()
    recipe = tmp_path / "recipes/evaluate/block_push/c_beso.json"
    write_json(recipe, {"env": "block_push", "method": "c_beso", "sampling": {**own, "steps": 5}})
    of_recipe = Policy.load(folder, device="cpu")
    assert asdict(of_recipe.sampling) == {**own, "steps": 5}
    assert asdict(Policy.load(folder, sampling={**own, "steps": 2}).sampling)["steps"] == 2
    write_json(folder / EVALUATION, {"env": "block_push", "sampling": {**own, "steps": 7}})
    assert asdict(Policy.load(folder).sampling)["steps"] == 7, "the folder's own comes first"
    assert caplog.text == ""
    goal, acted = np.ones(16), []
    for policy in (default, of_recipe):
        policy.reset(goal)
        acted.append(policy.act(np.zeros(16)))
    told = Policy.load(folder, sampling={**own, "steps": 5}, device="cpu")
    told.reset(goal)
    assert np.array_equal(told.act(np.zeros(16)), acted[1])
    assert not np.array_equal(*acted)


def test_a_folder_below_the_home_is_found(folder, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    assert Policy.load("~/models/block_push/c_beso").spec.goal_shape == (1, None)


@pytest.mark.parametrize(
    ("evaluation", "message"),
    [
        ({"env": "moon", "sampling": None}, "sampling = None: expected a mapping"),
        ({"env": "moon", "sampling": "own"}, "env = 'moon' is not one of block_push, "),
        ({"env": 5, "sampling": "own"}, "env = 5 is not one of"),
        ({"env": "block_push", "sampling": {"steps": 3}}, "sampling.sampler is missing"),
    ],
)
def test_a_damaged_evaluation_is_one_line(folder, small_models, evaluation, message):
    if evaluation["sampling"] == "own":
        evaluation["sampling"] = small_models["c_beso"][1]
    write_json(folder / EVALUATION, evaluation)
    with pytest.raises(UserError, match=r"evaluation\.json") as caught:
        Policy.load(folder)
    assert message in str(caught.value)


def test_the_spec_tells_what_the_arrays_are(folder, small_models, spec):
    unknown = Policy.load(folder).spec
    assert (unknown.environment, unknown.observation_shape, unknown.interface) == (None, (None,), None)
    assert "observation: (any,)" in str(unknown)
    write_json(folder / EVALUATION, {"env": "block_push", "sampling": small_models["c_beso"][1]})
    policy = Policy.load(folder)
    told = policy.spec
    assert (told.observation_shape, told.goal_shape, told.action_shape) == ((16,), (1, 16), (2,))
    assert told.seen == spec.visible
    assert told.seen_of_goals == (0, 1, 3, 4)
    lines = str(told).splitlines()
    assert "    10-11   target 1, x and y (m); not seen" in lines
    assert "    0-1     shift of the effector's target, x and y (m)" in lines
    policy.reset(np.zeros(16))
    with pytest.raises(UserError, match=r"observation has shape \(15,\), expected \(16,\)"):
        policy.act(np.zeros(15))


def test_weights_laid_out_for_acting_act_alike(folder, spec):
    """As archives keep them: every weight is a number of half precision."""
    path = checkpoint.paths(folder, 1)[0]
    kept = {name: value.half().float() for name, value in safetensors.torch.load_file(path).items()}
    safetensors.torch.save_file(kept, path)
    raw, cpu = np.random.default_rng(0).normal(size=(5, spec.observation_size)), torch.device("cpu")
    loaded = [Policy.load(folder, weights=weights, device="cpu") for weights in ("fp32", "fp16")]
    as_trained = checkpoint.load(folder, 1, loaded[0].sampling, cpu)
    expected, *others = [], [], []
    for policy, actions in zip([Policy(as_trained, cpu), *loaded], [expected, *others], strict=True):
        policy.reset(raw[0])
        actions += [policy.act(observation) for observation in raw]
    assert np.abs(expected).max() > 0.01
    for actions in others:
        np.testing.assert_allclose(actions, expected, atol=1e-5)


@pytest.mark.parametrize(
    ("weights", "scale", "told"), [("int8", 1, "weights = 'int8': must be"), ("fp16", 1e9, "has one beyond 65504")]
)
def test_weights_that_cannot_be_are_told(folder, weights, scale, told):
    path = checkpoint.paths(folder, 1)[0]
    large = {name: value * scale for name, value in safetensors.torch.load_file(path).items()}
    safetensors.torch.save_file(large, path)
    with pytest.raises(UserError, match=told):
        Policy.load(folder, weights=weights, device="cpu")
