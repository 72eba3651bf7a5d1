"""ScorePolicy around networks whose denoiser is known."""

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from torch import nn

from beso.core.noise import BatchNoise, EpisodeNoise
from beso.data.windows import Batch
from beso.diffusion.densities import DENSITIES
from beso.diffusion.score_policy import DiffusionConfig, ScorePolicy
from beso.networks.transformer import ScoreTransformer, TransformerConfig
from beso.sampling.diffusion import DiffusionSampling, GuidedSampling
from beso.sampling.samplers import SAMPLERS
from beso.sampling.schedules import SCHEDULES

B, T, O, A, G = 5, 3, 4, 2, 1  # noqa: E741 (the letters of the docstrings)
SIGMA_DATA, STD = 0.5, 0.3
DIFFUSION = DiffusionConfig(SIGMA_DATA, 0.05, 1.0, "log_logistic", math.log(0.5), 0.5, 1.0)


CONTEXTS = ("clean", "published", "renoised")


def sampling(sampler="ddim", steps=3, context="clean", sigma_min=0.05):
    return DiffusionSampling(sampler, "exponential", steps, sigma_min, 1.0, context, None)


def guided(scale, **choices):
    return GuidedSampling(**vars(sampling(**choices)), guidance_scale=scale)


class OptimalNetwork(nn.Module):
    """F of the best denoiser when an action is N(m, STD^2) around m = the goal's first A numbers.

    Records the actions it is given, in the scale of the noisy actions.
    """

    def __init__(self):
        super().__init__()
        self.seen = []

    def forward(self, actions, noise_level, observations, goal, last_only=False, generator=None):
        sigma = torch.exp(4 * noise_level)[:, None, None]
        total = sigma**2 + SIGMA_DATA**2
        noisy = actions * total.sqrt()
        self.seen.append(noisy)
        mean = goal[:, :, : actions.shape[-1]]
        denoised = mean + (noisy - mean) * STD**2 / (STD**2 + sigma**2)
        out = (denoised - SIGMA_DATA**2 / total * noisy) * total.sqrt() / (sigma * SIGMA_DATA)
        return out[:, -1:] if last_only else out


class GoalRecorder(nn.Module):
    """Predicts 0 and records the goals it is given."""

    def __init__(self):
        super().__init__()
        self.goals = []

    def forward(self, actions, noise_level, observations, goal, last_only=False, generator=None):
        self.goals.append(goal)
        return torch.zeros_like(actions)


def transformer():
    config = TransformerConfig(16, 2, 2, T, 0.2, 0.2, "sequential")
    network = ScoreTransformer(config, O, A, G, torch.Generator().manual_seed(0))
    with torch.no_grad():  # an initial network hardly depends on its inputs
        for parameter in network.parameters():
            parameter.mul_(8)
    return network


def batch(size=B):
    generator = torch.Generator().manual_seed(3)
    shapes = (size, T, O), (size, T, A), (size, G, O)
    return Batch(*(torch.randn(shape, generator=generator) for shape in shapes))


def act(policy, data=None, seed=0, steps=T):
    observations, actions, goal, *_ = data or batch()
    noise = BatchNoise(len(goal), torch.Generator().manual_seed(seed))
    with torch.no_grad():
        return policy.act(observations[:, :steps], actions[:, : steps - 1], goal, noise, {})


def initial_noise(count, seed=0):
    return torch.randn(count, 1, A, generator=torch.Generator().manual_seed(seed))[:, 0]


# Training objective


def test_loss_is_the_papers_weighted_denoising_error():
    data, policy = batch(), ScorePolicy(transformer(), DIFFUSION, sampling()).eval()
    loss = policy.loss(data, torch.Generator().manual_seed(7))

    # The same draws, then Eq. 6 in plain numbers: mean of alpha(sigma) |D(a + eps) - a|^2.
    generator = torch.Generator().manual_seed(7)
    uniform = torch.rand(B, generator=generator, dtype=torch.float64)
    eps = torch.randn(B, T, A, generator=generator)

    def cdf(sigma):
        return 1 / (1 + math.exp(-(math.log(sigma) - math.log(0.5)) / 0.5))

    terms = []
    for i in range(B):
        at = cdf(0.05) + (cdf(1.0) - cdf(0.05)) * uniform[i].item()
        sigma = 0.5 * (at / (1 - at)) ** 0.5
        total = sigma**2 + SIGMA_DATA**2
        noisy = data.actions[i : i + 1] + sigma * eps[i]
        level = torch.tensor([math.log(sigma) / 4])
        predicted = policy.network(noisy / math.sqrt(total), level, data.observations[i : i + 1], data.goal[i : i + 1])
        denoised = SIGMA_DATA**2 / total * noisy + sigma * SIGMA_DATA / math.sqrt(total) * predicted
        alpha = total / (sigma * SIGMA_DATA) ** 2
        terms.append(alpha * (denoised - data.actions[i]).square().mean())
    assert loss.item() == pytest.approx(torch.stack(terms).mean().item(), rel=1e-5)


def test_loss_of_the_optimal_network_is_the_irreducible_error():
    """For N(m, s^2): E|D - a|^2 = s^2 sigma^2 / (s^2 + sigma^2) an element."""
    diffusion = DiffusionConfig(SIGMA_DATA, 0.2, 0.2 + 1e-9, "uniform", 0.0, 1.0, 1.0)
    generator, count = torch.Generator().manual_seed(0), 20_000
    goal = torch.randn(count, 1, O, generator=generator)
    actions = goal[:, :, :A] + STD * torch.randn(count, T, A, generator=generator)
    data = Batch(torch.zeros(count, T, O), actions, goal)
    loss = ScorePolicy(OptimalNetwork(), diffusion, sampling()).loss(data, generator)
    alpha = (0.2**2 + SIGMA_DATA**2) / (0.2 * SIGMA_DATA) ** 2
    expected = alpha * STD**2 * 0.2**2 / (STD**2 + 0.2**2)
    assert loss.item() == pytest.approx(expected, rel=4 * math.sqrt(2 / (count * T * A)))  # four standard errors


def test_dropout_and_goal_dropout_act_in_training_mode_only():
    policy, data = ScorePolicy(transformer(), DIFFUSION, sampling(), goal_dropout=0.5), batch()
    draws = [torch.Generator().manual_seed(1) for _ in range(4)]
    first, second = policy.eval().loss(data, draws[0]), policy.eval().loss(data, draws[1])
    without = ScorePolicy(policy.network, DIFFUSION, sampling()).eval().loss(data, draws[2])
    training = policy.train().loss(data, draws[3])
    assert first == second == without
    assert training != first


def test_training_loss_depends_on_the_generator_alone():
    policy, data = ScorePolicy(transformer(), DIFFUSION, sampling(), goal_dropout=0.5).train(), batch()
    torch.manual_seed(1)
    first = policy.loss(data, torch.Generator().manual_seed(1))
    torch.manual_seed(2)
    assert policy.loss(data, torch.Generator().manual_seed(1)) == first
    assert policy.loss(data, torch.Generator().manual_seed(2)) != first


def test_goal_dropout_removes_whole_goals_at_its_rate():
    count, rate, network = 4000, 0.1, GoalRecorder()
    goal = torch.rand(count, 3, O, generator=torch.Generator().manual_seed(0)) + 1
    data = Batch(torch.zeros(count, T, O), torch.zeros(count, T, A), goal)
    ScorePolicy(network, DIFFUSION, sampling(), goal_dropout=rate).train().loss(data, torch.Generator().manual_seed(0))
    seen = network.goals[0]
    dropped = (seen == 0).all(dim=(1, 2))
    assert torch.equal(seen[~dropped], goal[~dropped])
    share = dropped.float().mean().item()
    assert share == pytest.approx(rate, abs=4 * math.sqrt(rate * (1 - rate) / count))  # four standard errors


# Action generation


def test_act_follows_the_ode_of_a_known_denoiser():
    data = batch()
    policy = ScorePolicy(OptimalNetwork(), DIFFUSION, sampling("heun", steps=80, sigma_min=0.01)).eval()
    mean = data.goal[:, 0, :A]
    exact = mean + (initial_noise(B) - mean) * STD / math.sqrt(STD**2 + 1)
    # The last, first-order step from sigma = 0.01 leaves about (0.01 / STD)^2 / 2 = 6e-4 of the deviation.
    assert torch.allclose(act(policy, data), exact, atol=2e-3)


@pytest.mark.parametrize("context", CONTEXTS)
@pytest.mark.parametrize("sampler", ["ddim", "euler_ancestral", "dpmpp_2m", "dpm_2_ancestral"])
def test_act_is_deterministic_given_its_noise(sampler, context):
    policy = ScorePolicy(transformer(), DIFFUSION, sampling(sampler, context=context)).eval()
    assert torch.equal(act(policy), act(policy))
    assert not torch.allclose(act(policy), act(policy, seed=1))


@pytest.mark.parametrize("steps", [1, 2, 3])
@pytest.mark.parametrize("context", CONTEXTS)
def test_act_works_while_the_context_grows(context, steps):
    policy = ScorePolicy(transformer(), DIFFUSION, guided(2.0, sampler="euler_ancestral", context=context))
    action = act(policy.eval(), steps=steps)
    assert action.shape == (B, A)
    assert action.isfinite().all()


def test_clean_context_keeps_previous_actions_through_all_denoising_steps():
    data, network = batch(), OptimalNetwork()
    act(ScorePolicy(network, DIFFUSION, sampling("heun", steps=4)).eval(), data)
    assert len(network.seen) == 7
    for seen in network.seen:
        assert torch.allclose(seen[:, :-1], data.actions[:, : T - 1], atol=1e-6)


def test_renoised_context_has_the_level_of_each_denoising_step():
    data, network = batch(), OptimalNetwork()
    act(ScorePolicy(network, DIFFUSION, sampling(steps=4, context="renoised")).eval(), data)
    eps = [
        (seen[:, :-1] - data.actions[:, : T - 1]) / sigma
        for seen, sigma in zip(network.seen, sampling_levels(4), strict=False)
    ]
    assert len(eps) == 4
    assert all(torch.allclose(found, eps[0], atol=1e-4) for found in eps)
    assert eps[0].std() > 0.5


def test_published_context_moves_previous_actions_with_the_new_one():
    data, network = batch(), OptimalNetwork()
    act(ScorePolicy(network, DIFFUSION, sampling(context="published")).eval(), data)
    first, second = network.seen[:2]
    assert torch.allclose(first[:, :-1], data.actions[:, : T - 1], atol=1e-6)
    sigmas = sampling_levels()
    mean = data.goal[:, :, :A]
    denoised = mean + (first - mean) * STD**2 / (STD**2 + sigmas[0] ** 2)
    expected = sigmas[1] / sigmas[0] * first + (1 - sigmas[1] / sigmas[0]) * denoised
    assert torch.allclose(second, expected, atol=1e-6)


def sampling_levels(steps=3):
    return sampling(steps=steps).sigmas()


def test_all_contexts_agree_where_there_are_no_previous_actions():
    network = transformer()
    clean, *others = (ScorePolicy(network, DIFFUSION, sampling(context=c)).eval() for c in CONTEXTS)
    for other in others:
        assert torch.allclose(act(clean, steps=1), act(other, steps=1), atol=1e-6)
        assert not torch.allclose(act(clean), act(other), atol=1e-4)


@pytest.mark.parametrize("context", CONTEXTS)
def test_guidance_scale_decides_how_much_the_goal_matters(context):
    network, data = transformer(), batch()
    other = data._replace(goal=data.goal.flip(0))
    unconditional = data._replace(goal=torch.zeros_like(data.goal))

    def policy(scale):
        return ScorePolicy(network, DIFFUSION, guided(scale, context=context)).eval()

    assert torch.equal(act(policy(0.0), data), act(policy(0.0), other))
    assert torch.equal(act(policy(0.0), data), act(policy(1.0), unconditional))
    assert not torch.allclose(act(policy(1.0), data), act(policy(1.0), other), atol=1e-3)
    assert not torch.allclose(act(policy(2.0), data), act(policy(1.0), data), atol=1e-3)
    # Without a goal both branches are the same and the scale has nothing to mix.
    assert torch.allclose(act(policy(2.0), unconditional), act(policy(0.0), unconditional), atol=1e-5)


def test_guidance_mixes_denoisers_with_the_papers_weights():
    """One step to 0 returns D itself: for the Gaussian, mean (1 - k) + a k with the mean lambda * goal."""
    data = batch()
    policy = ScorePolicy(OptimalNetwork(), DIFFUSION, guided(2.0, steps=1)).eval()
    keep = STD**2 / (STD**2 + 1)
    expected = 2 * data.goal[:, 0, :A] * (1 - keep) + initial_noise(B) * keep
    assert torch.allclose(act(policy, data), expected, atol=1e-5)


def test_only_the_current_action_is_computed_like_the_full_window():
    policy, data = ScorePolicy(transformer(), DIFFUSION, sampling()).eval(), batch()
    arguments = (data.actions, 0.3, data.observations, data.goal)
    with torch.no_grad():
        last, full = policy.denoise(*arguments), policy.denoise(*arguments, last_only=False)
    assert torch.allclose(last, full[:, -1:], atol=1e-5)


def test_an_episodes_action_does_not_depend_on_its_neighbours():
    data = batch()
    policy = ScorePolicy(transformer(), DIFFUSION, guided(1.5, sampler="euler_ancestral")).eval()
    rows = torch.tensor([3, 1])
    picked = (data.observations[rows], data.actions[rows, :-1], data.goal[rows])
    with torch.no_grad():
        together = policy.act(
            data.observations,
            data.actions[:, :-1],
            data.goal,
            EpisodeNoise([np.random.default_rng(i) for i in range(B)]),
            {},
        )
        alone = policy.act(*picked, EpisodeNoise([np.random.default_rng(3), np.random.default_rng(1)]), {})
    assert torch.allclose(together[rows], alone, atol=1e-5)


class LevelBlind(nn.Module):
    """A network that is not told the noise level."""

    def __init__(self):
        super().__init__()
        self.inner = transformer()

    def forward(self, actions, noise_level, *arguments, **keywords):
        return self.inner(actions, torch.zeros_like(noise_level), *arguments, **keywords)


def test_a_wider_range_of_actions_with_as_much_wider_noise_changes_nothing_but_the_level():
    found = []
    for width in (1.0, 3.0):
        config = DiffusionConfig(0.5 * width, 0.05 * width, width, "uniform", 0.0, 1.0, width)
        chosen = DiffusionSampling("euler_ancestral", "exponential", 4, 0.05 * width, width, "clean", None)
        policy = ScorePolicy(LevelBlind(), config, chosen).eval()
        found.append((policy.loss(batch(), torch.Generator().manual_seed(1)), act(policy)))
    assert torch.allclose(found[0][0], found[1][0], rtol=1e-4)
    assert torch.allclose(found[0][1], found[1][1], atol=1e-4)


# Configuration


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"sigma_data": 0.0}, "sigma_data = 0.0"),
        ({"sigma_min": 1.0}, "sigma_min = 1.0"),
        ({"sigma_min": 0.0}, "sigma_min = 0.0"),
        ({"scale": 0.0}, "scale = 0.0"),
        ({"action_range": 0.0}, "action_range = 0.0"),
    ],
)
def test_impossible_training_noise_is_refused(changes, message):
    values = {"sigma_data": 0.5, "sigma_min": 0.05, "sigma_max": 1.0, "density": "uniform", "location": 0.0}
    values |= {"scale": 1.0, "action_range": 1.0}
    with pytest.raises(ValueError, match=message):
        DiffusionConfig(**{**values, **changes})


def test_impossible_sampling_is_refused():
    with pytest.raises(ValueError, match="steps = 0"):
        sampling(steps=0)
    with pytest.raises(ValueError, match="sigma_min = 2"):
        sampling(sigma_min=2.0)


def test_default_is_the_papers_sampler_over_the_training_range():
    config = SimpleNamespace(diffusion=DIFFUSION)
    assert DiffusionSampling.default(config) == DiffusionSampling("ddim", "exponential", 3, 0.05, 1.0, "clean", None)
    assert GuidedSampling.default(config) == guided(1.0)


def test_goals_are_lost_from_their_share_of_the_training_on():
    network = GoalRecorder()
    policy = ScorePolicy(network, DIFFUSION, sampling(), goal_dropout=0.5, goal_dropout_from=0.6).train()
    for done, expected in ((0.0, False), (0.59, False), (0.6, True), (1.0, True)):
        policy.schedule(done)
        policy.loss(batch(64), torch.Generator().manual_seed(0))
        assert (network.goals[-1] == 0).all(dim=(1, 2)).any() == expected, done


def test_a_learned_null_goal_stands_for_no_goal_in_training_and_guidance():
    network, null = GoalRecorder(), torch.full((G, O), 7.0)
    policy = ScorePolicy(network, DIFFUSION, guided(2.0), goal_dropout=0.5, null_goal=null).train()
    policy.loss(batch(64), torch.Generator().manual_seed(0))
    lost = (network.goals[-1] == 7).all(dim=(1, 2))
    assert 16 < lost.sum() < 48
    assert torch.equal(network.goals[-1][~lost], batch(64).goal[~lost])
    act(policy, steps=1)
    conditional, unconditional = network.goals[-1].chunk(2)
    assert torch.equal(conditional, batch().goal)
    assert (unconditional == 7).all()
    policy.sampling = guided(0.0)
    act(policy, steps=1)
    assert (network.goals[-1] == 7).all()
    assert [name for name, _ in policy.named_parameters()] == ["null_goal"], "it is trained and saved"


@pytest.mark.parametrize("field", ["sampler", "schedule"])
def test_unknown_names_are_refused_with_what_is_allowed(field):
    values = {**dataclasses.asdict(sampling()), field: "x"}
    with pytest.raises(
        ValueError, match=f"{field} = 'x': must be one of {', '.join(SAMPLERS if field == 'sampler' else SCHEDULES)}"
    ):
        DiffusionSampling(**values)
    with pytest.raises(ValueError, match=f"density = 'x': must be one of {', '.join(DENSITIES)}"):
        dataclasses.replace(DIFFUSION, density="x")
