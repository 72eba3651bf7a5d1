import torch

from beso.networks.sequence import SequenceTransformer


def make(causal, dropout_rate=0.0, seed=0):
    return SequenceTransformer(5, 3, 6, 16, 2, 4, dropout_rate, causal, torch.Generator().manual_seed(seed))


def changed(network, position):
    """Which of six outputs change with one input."""
    x = torch.randn(1, 6, 5, generator=torch.Generator().manual_seed(1))
    other = x.clone()
    other[:, position] += 1
    with torch.no_grad():
        return (network(x) != network(other)).any(dim=2)[0].tolist()


def test_a_causal_output_depends_on_what_precedes_it():
    assert changed(make(causal=True), 2) == [False, False, True, True, True, True]


def test_without_causality_every_output_depends_on_every_input():
    assert changed(make(causal=False), 2) == [True] * 6


def test_shorter_sequences_fit():
    assert make(causal=True)(torch.zeros(2, 4, 5)).shape == (2, 4, 3)


def test_dropout_is_on_only_with_a_generator():
    network, x = make(causal=True, dropout_rate=0.3), torch.ones(2, 6, 5)
    with torch.no_grad():
        assert torch.equal(network(x), network(x))
        dropped = [network(x, torch.Generator().manual_seed(seed)) for seed in (0, 0, 1)]
    assert torch.equal(dropped[0], dropped[1])
    assert not torch.equal(dropped[0], dropped[2])


def test_initial_weights_come_from_the_generator_alone():
    first, again, other = (make(True, seed=seed).state_dict() for seed in (0, 0, 1))
    assert all(torch.equal(first[key], again[key]) for key in first)
    assert not torch.equal(first["embed.weight"], other["embed.weight"])
