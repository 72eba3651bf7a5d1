import pytest
import torch

from beso.networks.logistic_mixture import (
    SMALLEST_LOG_SCALE,
    LogisticMixture,
    from_outputs,
    negative_log_likelihood,
    sample,
)


def mixtures(*shape, seed=0, log_scale=-1.5):
    """Random mixtures of 4 components, in double precision."""
    draws = torch.Generator().manual_seed(seed)
    logits, means, spread = (torch.randn(*shape, 4, generator=draws, dtype=torch.float64) for _ in range(3))
    return LogisticMixture(logits, 0.7 * means, log_scale + spread)


@pytest.mark.parametrize("classes", [2, 10, 256])
def test_probabilities_of_all_classes_add_up_to_one(classes):
    centres = torch.linspace(-1, 1, classes, dtype=torch.float64)[:, None].expand(-1, 5)
    probabilities = (-negative_log_likelihood(mixtures(5), centres, classes)).exp()
    assert torch.allclose(probabilities.sum(dim=0), torch.ones(5, dtype=torch.float64), atol=1e-10)


def test_a_number_has_the_mass_of_the_logistic_distributions_around_it():
    mixture, classes = mixtures(3), 10
    x = torch.tensor([-0.4, 0.05, 0.7], dtype=torch.float64)

    def below(border):
        components = torch.sigmoid((border[:, None] - mixture.means) / mixture.log_scales.exp())
        return (mixture.logits.softmax(-1) * components).sum(-1)

    expected = -(below(x + 1 / 9) - below(x - 1 / 9)).log()
    assert torch.allclose(negative_log_likelihood(mixture, x, classes), expected, atol=1e-10)


def test_the_outermost_classes_reach_to_infinity():
    mixture = LogisticMixture(torch.zeros(1, 1), torch.full((1, 1), 30.0), torch.zeros(1, 1))
    assert negative_log_likelihood(mixture, torch.tensor([1.0]), 256).item() == pytest.approx(0, abs=1e-6)
    assert negative_log_likelihood(mixture, torch.tensor([1.3]), 256).item() == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("log_scale", [SMALLEST_LOG_SCALE, 0.0, 20.0])
def test_likelihood_and_gradients_are_finite_in_single_precision(log_scale):
    logits, means = torch.zeros(3, 4), torch.tensor([-9.0, -0.3, 0.2, 9.0]).expand(3, -1)
    scales = torch.full((3, 4), log_scale)
    parts = [part.clone().requires_grad_() for part in (logits, means, scales)]
    loss = negative_log_likelihood(LogisticMixture(*parts), torch.tensor([-1.0, 0.1, 1.0]), 256)
    loss.sum().backward()
    assert loss.isfinite().all()
    assert all(part.grad.isfinite().all() for part in parts)


def test_scales_have_a_floor():
    outputs = torch.full((2, 3 * 5 * 3), -50.0)
    mixture = from_outputs(outputs, 5)
    assert mixture.means.shape == (2, 3, 5)
    assert (mixture.log_scales == SMALLEST_LOG_SCALE).all()


def test_samples_follow_the_likelihood():
    mixture, classes, count = mixtures(1), 11, 100_000
    uniform = torch.rand(count, 1, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    drawn = sample(LogisticMixture(*(part.expand(count, 1, 4) for part in mixture)), uniform)
    counts = torch.bincount(((drawn + 1) * 5).round().long().flatten(), minlength=classes) / count
    centres = torch.linspace(-1, 1, classes, dtype=torch.float64)[:, None]
    expected = (-negative_log_likelihood(mixture, centres, classes)).exp().squeeze(1)
    # Clipped samples fall into the outermost classes, which begin half a class inside.
    assert torch.allclose(counts.double(), expected, atol=4 * 0.5 / count**0.5)
