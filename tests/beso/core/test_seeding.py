import itertools

import numpy as np
import torch

from beso.core.seeding import generator, integer_seed, seed_sequence, torch_generator

NAMES = [(0, "a"), (0, "a", 0), (0, "a", 1), (0, "a", 1, 0), (0, "a", 0, 1), (0, "b", 0), (1, "a", 0), (0, "b", 1)]


def test_streams_of_different_names_differ():
    first = [generator(*name).integers(2**63) for name in NAMES]
    seeds = [integer_seed(*name) for name in NAMES]
    assert len(set(first)) == len(set(seeds)) == len(NAMES)


def test_streams_of_different_names_are_uncorrelated():
    drawn = np.stack([generator(*name).standard_normal(10_000) for name in NAMES])
    correlations = np.corrcoef(drawn)[np.triu_indices(len(NAMES), 1)]
    assert np.abs(correlations).max() < 4.5 / np.sqrt(10_000)


def test_a_stream_does_not_depend_on_what_was_drawn_before():
    expected = generator(0, "noise", 7).standard_normal(5)
    np.random.seed(3)
    torch.manual_seed(3)
    for episode in range(7):
        generator(0, "noise", episode).standard_normal(100)
    assert np.array_equal(generator(0, "noise", 7).standard_normal(5), expected)


def test_the_same_name_gives_the_same_numbers_in_every_process():
    """Python's own hash of the role would not: it is salted. The number is this library's, noted once."""
    assert generator(5, "policy noise", 3, 1).integers(2**63) == 266134823163585076


def test_integer_seeds_suit_gymnasium_and_torch():
    seeds = [integer_seed(0, "start", i) for i in range(1000)]
    assert all(0 <= seed < 2**63 for seed in seeds)
    assert max(seeds) > 2**62, "all 63 bits are used"
    assert torch_generator(0, "start", 4).initial_seed() == seeds[4]


def test_torch_generators_repeat_and_differ():
    streams = [torch.rand(4, generator=torch_generator(0, "weights", seed)) for seed in (1, 1, 2)]
    assert torch.equal(streams[0], streams[1])
    assert not torch.equal(streams[0], streams[2])


def test_seed_sequences_are_numpys_own():
    pools = [tuple(seed_sequence(*name).generate_state(4)) for name in NAMES]
    assert all(a != b for a, b in itertools.combinations(pools, 2))
