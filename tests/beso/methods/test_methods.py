"""What every method promises (beso.core.method.BaseMethod), and that each learns what it is for."""

import numpy as np
import pytest
import torch

from beso import methods
from beso.config import build
from beso.core.noise import EpisodeNoise
from beso.errors import UserError
from tests.beso.conftest import TEACHERS
from tests.beso.methods import SIZES, batch

NAMES = methods.names()


@pytest.fixture
def make(small_models):
    def make(name, sizes=SIZES, seed=0, model=None, sampling=None):
        module, (model_values, sampling_values) = methods.load(name), small_models[name]
        config = build(module.Config, {**model_values, **(model or {})}, "model")
        chosen = build(methods.sampling(name), {**sampling_values, **(sampling or {})}, "sampling")
        method = module.Method(config, chosen, sizes, torch.Generator().manual_seed(seed))
        if name in TEACHERS:
            method.learn_from(make(TEACHERS[name], sizes, seed)[0].eval())
        return method, config

    return make


def train_a_little(method, window, updates=5):
    """Move the weights away from their start, where hardly anything depends on the inputs."""
    optimizer, draws = torch.optim.Adam(method.parameters(), 1e-2), torch.Generator().manual_seed(0)
    for i in range(updates):
        method.train().loss(batch(16, window, seed=i), draws).backward()
        optimizer.step()
        optimizer.zero_grad()
    return method.eval()


def episode_noise(count):
    return EpisodeNoise([np.random.default_rng(i) for i in range(count)])


def test_every_method_has_a_small_configuration_here(small_models):
    assert sorted(small_models) == NAMES


def test_an_unknown_method_is_refused_with_what_is_allowed():
    with pytest.raises(UserError, match=r"method 'cbeso' is not one of .*c_beso"):
        methods.load("cbeso")


@pytest.mark.parametrize("name", NAMES)
def test_loss_is_a_finite_scalar_with_gradients_to_all_parameters(make, name):
    method, config = make(name)
    loss = method.train().loss(batch(8, config.window), torch.Generator().manual_seed(0))
    assert loss.shape == ()
    assert loss.isfinite()
    loss.backward()
    for key, parameter in method.named_parameters():
        assert parameter.grad is not None, key
        assert parameter.grad.isfinite().all(), key
        assert (parameter.grad != 0).any(), key


@pytest.mark.parametrize("name", NAMES)
def test_loss_is_decided_by_weights_batch_and_generator(make, name):
    losses = []
    for global_seed, seed in ((1, 5), (2, 5), (3, 6)):
        torch.manual_seed(global_seed)
        method, config = make(name, seed=4)
        losses.append(method.train().loss(batch(8, config.window), torch.Generator().manual_seed(seed)).item())
    assert losses[0] == losses[1]
    assert losses[0] != losses[2]


@pytest.mark.parametrize("name", NAMES)
def test_acts_with_every_length_of_context(make, name):
    method, config = make(name)
    method.eval()
    for steps in range(1, config.window + 1):
        observations, actions, goal, *_ = batch(4, steps)
        action = method.act(observations, actions[:, :-1], goal, episode_noise(4), {})
        assert action.shape == (4, SIZES.action)
        assert action.isfinite().all()


@pytest.mark.parametrize("name", NAMES)
def test_a_batch_of_seven_acts_like_seven_single_calls(make, name):
    method, config = make(name)
    train_a_little(method, config.window)
    observations, actions, goal, *_ = batch(7, config.window)
    with torch.inference_mode():
        together = method.act(observations, actions[:, :-1], goal, episode_noise(7), {})
        for i in range(7):
            one = EpisodeNoise([np.random.default_rng(i)])
            alone = method.act(observations[i : i + 1], actions[i : i + 1, :-1], goal[i : i + 1], one, {})
            # Matrix products of other batch sizes round differently.
            assert torch.allclose(together[i], alone[0], atol=1e-5)


@pytest.mark.parametrize("name", NAMES)
def test_what_a_method_remembers_stays_with_its_episode(make, name):
    """Three steps of five episodes, two of which end after the second, beside each episode alone."""
    method, config = make(name)
    train_a_little(method, config.window)
    steps = [batch(5, 1, seed=seed) for seed in range(3)]
    goal, none = steps[0].goal, steps[0].actions[:, :0]
    noise, memory, kept = episode_noise(5), {}, np.array([True, False, True, False, True])
    with torch.inference_mode():
        together = [method.act(step.observations, none, goal, noise, memory) for step in steps[:2]]
        noise.keep(kept)
        memory = {key: value[torch.from_numpy(kept)] for key, value in memory.items()}
        together.append(method.act(steps[2].observations[kept], none[kept], goal[kept], noise, memory))
        for row, i in enumerate(np.flatnonzero(kept)):
            one, memory = EpisodeNoise([np.random.default_rng(i)]), {}
            for step, acted in zip(steps, (together[0][i], together[1][i], together[2][row]), strict=True):
                alone = method.act(step.observations[i : i + 1], none[:1], goal[i : i + 1], one, memory)
                assert torch.allclose(acted, alone[0], atol=1e-5)


@pytest.mark.parametrize("name", NAMES)
def test_actions_depend_on_state_and_goal(make, name):
    method, config = make(name)
    train_a_little(method, config.window)
    observations, actions, goal, *_ = batch(30, config.window)

    def act(observations, goal):
        with torch.inference_mode():
            return method.act(observations, actions[:, :-1], goal, episode_noise(30), {})

    before = act(observations, goal)
    assert torch.equal(before, act(observations, goal))
    assert not torch.allclose(before, act(observations + 1, goal), atol=1e-4)
    assert not torch.allclose(before, act(observations, goal + 1), atol=1e-4)


@pytest.mark.parametrize("name", NAMES)
def test_weights_survive_a_round_trip(make, name):
    method, config = make(name, seed=0)
    train_a_little(method, config.window)
    copy, _ = make(name, seed=1)
    copy.load_state_dict({key: value.clone() for key, value in method.state_dict().items()})
    copy.eval()
    observations, actions, goal, *_ = batch(3, config.window)
    with torch.inference_mode():
        results = [m.act(observations, actions[:, :-1], goal, episode_noise(3), {}) for m in (method, copy)]
    assert torch.equal(*results)


@pytest.mark.parametrize("name", NAMES)
def test_without_sampling_a_method_uses_its_default(make, name, small_models):
    _, config = make(name)
    sampling = methods.sampling(name).default(config)
    method = methods.load(name).Method(config, sampling, SIZES, torch.Generator().manual_seed(0)).eval()
    observations, actions, goal, *_ = batch(3, config.window)
    assert method.act(observations, actions[:, :-1], goal, episode_noise(3), {}).shape == (3, SIZES.action)
