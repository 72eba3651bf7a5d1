import numpy as np
import torch

from beso.noise import BatchNoise, EpisodeNoise


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
