import numpy as np
import torch

from beso.core.noise import BatchNoise, EpisodeNoise, categorical


def episodes(*numbers):
    return EpisodeNoise([np.random.default_rng(i) for i in numbers])


def test_an_episodes_numbers_do_not_depend_on_its_neighbours():
    together, apart = episodes(0, 1, 2), episodes(2)
    for shape in ((1, 2), (3,), (1, 2)):
        assert torch.equal(together.normal(*shape)[2], apart.normal(*shape)[0])


def test_episodes_that_go_on_keep_their_streams():
    some, whole = episodes(0, 1, 2, 3), episodes(0, 1, 2, 3)
    assert torch.equal(some.normal(2), whole.normal(2))
    some.keep(np.array([True, False, False, True]))
    assert torch.equal(some.normal(2), whole.normal(2)[[0, 3]])
    some.keep(np.array([False, True]))
    assert torch.equal(some.normal(2), whole.normal(2)[[3]])


def test_numbers_are_standard_normal_in_single_precision():
    for noise in (episodes(0, 1), BatchNoise(2, torch.Generator().manual_seed(0))):
        drawn = noise.normal(50_000, 1)
        assert drawn.shape == (2, 50_000, 1)
        assert drawn.dtype == torch.float32
        assert drawn.mean().abs() < 4 / np.sqrt(100_000)  # four standard errors
        assert abs(drawn.var() - 1) < 4 * np.sqrt(2 / 100_000)


def test_batch_noise_is_its_generators():
    drawn = BatchNoise(3, torch.Generator().manual_seed(5)).normal(1, 2)
    assert torch.equal(drawn, torch.randn(3, 1, 2, generator=torch.Generator().manual_seed(5)))


def test_uniform_numbers_have_the_right_shape_and_range():
    for noise in (episodes(0, 1), BatchNoise(2, torch.Generator().manual_seed(0))):
        drawn = noise.uniform(500, 2)
        assert drawn.shape == (2, 500, 2)
        assert 0 <= drawn.min() < 0.02
        assert 0.98 < drawn.max() < 1


def test_categorical_draws_classes_with_their_probabilities():
    probabilities = torch.tensor([[0.1, 0.0, 0.6, 0.3], [2.0, 2.0, 0.0, 0.0]])
    uniform = torch.rand(2, 40_000, generator=torch.Generator().manual_seed(0))
    drawn = categorical(probabilities, uniform)
    shares = torch.stack([torch.bincount(row, minlength=4) for row in drawn]) / 40_000
    expected = probabilities / probabilities.sum(dim=1, keepdim=True)
    assert torch.allclose(shares, expected, atol=4 * 0.5 / 200)
    assert (shares[expected == 0] == 0).all()


def test_categorical_never_leaves_the_classes():
    nearly_one = torch.tensor([[0.0, 1 - 2**-24]])
    assert categorical(torch.tensor([[0.3, 0.7]]), nearly_one).tolist() == [[0, 1]]
