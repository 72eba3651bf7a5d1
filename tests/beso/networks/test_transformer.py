import math

import pytest
import safetensors.torch
import torch
from torch.nn import functional

from beso.networks import blocks
from beso.networks.blocks import ALL
from beso.networks.transformer import ScoreTransformer, TransformerConfig

B, T, O, A, G = 3, 5, 6, 2, 2  # noqa: E741 (the letters of the docstrings)


def make(conditioning="sequential", dropout=0.0, width=24, layers=3, heads=4, goal_window=G, seed=0):
    config = TransformerConfig(width, layers, heads, T, dropout, dropout, conditioning)
    network = ScoreTransformer(config, O, A, goal_window, torch.Generator().manual_seed(seed))
    with torch.no_grad():  # weights of a trained network's size, so that every input matters
        for name, parameter in network.named_parameters():
            if "norm" not in name:
                parameter.mul_(10)
    return network


def inputs(steps=T, goal_window=G, size=B):
    generator = torch.Generator().manual_seed(1)
    shapes = (size, steps, A), (size,), (size, steps, O), (size, goal_window, O)
    return [torch.randn(shape, generator=generator) for shape in shapes]


def perturb_film(network):
    generator = torch.Generator().manual_seed(5)
    with torch.no_grad():
        for block in network.blocks:
            block.film[-1].weight.normal_(0, 0.3, generator=generator)


def parameters(network):
    return sum(p.numel() for p in network.parameters())


@pytest.mark.parametrize(
    ("width", "layers", "heads", "sizes", "expected"),
    [(240, 4, 12, (10, 2, 1), 2_783_762), (360, 6, 6, (30, 9, 2), 9_381_609)],
    ids=["block_push", "kitchen"],
)
def test_has_as_many_parameters_as_the_published_network(width, layers, heads, sizes, expected):
    """Counted on the published class at window 5."""
    config = TransformerConfig(width, layers, heads, 5, 0.05, 0.05, "sequential")
    assert parameters(ScoreTransformer(config, *sizes, torch.Generator())) == expected


def test_starts_like_gpt_2():
    config = TransformerConfig(96, 2, 4, T, 0.0, 0.0, "sequential")
    network = ScoreTransformer(config, O, A, G, torch.Generator().manual_seed(0))
    for name, parameter in network.named_parameters():
        if name.endswith("bias"):
            assert (parameter == 0).all(), name
        elif "norm" in name:
            assert (parameter == 1).all(), name
        else:
            error = 4 * 0.02 / math.sqrt(2 * parameter.numel())  # four standard errors of a standard deviation
            assert parameter.std().item() == pytest.approx(0.02, abs=error), name


def test_initial_weights_come_from_the_generator_alone():
    torch.manual_seed(1)
    first = make(seed=3).state_dict()
    torch.manual_seed(2)
    again, other = make(seed=3).state_dict(), make(seed=4).state_dict()
    assert all(torch.equal(first[key], again[key]) for key in first)
    assert not torch.equal(first["head.weight"], other["head.weight"])


@pytest.mark.parametrize("conditioning", ["sequential", "film"])
def test_a_prediction_depends_on_the_past_and_never_on_the_future(conditioning):
    network, arguments = make(conditioning), inputs()
    if conditioning == "film":
        perturb_film(network)

    def output(position, step=None):
        changed = [x.clone() for x in arguments]
        changed[position] = changed[position] + 1 if step is None else changed[position]
        if step is not None:
            changed[position][:, step] += 1
        with torch.no_grad():
            return network(*changed)

    with torch.no_grad():
        before = network(*arguments)
    for position in (0, 2):  # actions, states
        for step in range(T):
            moved = (output(position, step) - before).abs().amax(dim=(0, 2))
            assert (moved[:step] == 0).all(), "a later state or action reached an earlier prediction"
            assert (moved[step:] > 1e-4).all(), "a prediction must see its own and all earlier states and actions"
    for position in (1, 3):  # sigma, goal
        assert ((output(position) - before).abs().amax(dim=2) > 1e-4).all()


def test_every_state_of_a_goal_matters_and_so_does_their_order():
    network, arguments = make(), inputs()
    swapped = [*arguments[:3], arguments[3].flip(1)]
    with torch.no_grad():
        assert (network(*swapped) - network(*arguments)).abs().max() > 1e-3


@pytest.mark.parametrize("conditioning", ["sequential", "film"])
def test_last_only_is_the_last_column_of_the_full_pass(conditioning):
    network = make(conditioning)
    if conditioning == "film":
        perturb_film(network)
    for steps in (1, 2, T):
        arguments = inputs(steps)
        with torch.no_grad():
            full, last = network(*arguments), network(*arguments, last_only=True)
        assert full.shape == (B, steps, A)
        assert last.shape == (B, 1, A)
        assert torch.allclose(last, full[:, -1:], atol=1e-5)


def test_a_shorter_context_gives_the_same_first_predictions():
    network, (actions, level, observations, goal) = make(), inputs()
    with torch.no_grad():
        full = network(actions, level, observations, goal)
        for steps in range(1, T):
            short = network(actions[:, :steps], level, observations[:, :steps], goal)
            assert torch.allclose(short, full[:, :steps], atol=1e-5)


@pytest.mark.parametrize("last_only", [False, True])
def test_plain_attention_equals_the_fused_kernel(monkeypatch, last_only):
    network, arguments = make(), inputs()
    with torch.no_grad():
        plain = network(*arguments, last_only=last_only)
        monkeypatch.setattr(blocks, "fused_attention_pays", lambda device: True)
        fused = network(*arguments, last_only=last_only)
    assert not torch.equal(plain, fused)  # two computations
    assert torch.allclose(plain, fused, atol=1e-5)


def test_last_only_works_with_dropout_too():
    network = make(dropout=0.1)
    output = network(*inputs(), last_only=True, generator=torch.Generator().manual_seed(0))
    assert output.shape == (B, 1, A)


def test_dropout_is_on_only_with_a_generator():
    network, arguments = make(dropout=0.3).train(), inputs()
    with torch.no_grad():
        plain, again = network(*arguments), network(*arguments)
        dropped = network(*arguments, generator=torch.Generator().manual_seed(0))
        same = network(*arguments, generator=torch.Generator().manual_seed(0))
        other = network(*arguments, generator=torch.Generator().manual_seed(1))
    assert torch.equal(plain, again)
    assert torch.equal(dropped, same)
    assert not torch.allclose(dropped, plain, atol=1e-3)
    assert not torch.allclose(dropped, other, atol=1e-3)


@pytest.mark.parametrize("which", ["attention", "residual"])
def test_each_dropout_rate_acts_on_its_own(which):
    rates = (0.3, 0.0) if which == "attention" else (0.0, 0.3)
    config = TransformerConfig(24, 2, 4, T, *rates, "sequential")
    network, arguments = ScoreTransformer(config, O, A, G, torch.Generator().manual_seed(0)), inputs()
    with torch.no_grad():
        dropped = network(*arguments, generator=torch.Generator().manual_seed(0))
        assert not torch.equal(dropped, network(*arguments))


@pytest.mark.parametrize("heads", [1, 3])
def test_attention_agrees_with_the_textbook_formula(heads):
    """softmax(q k / sqrt(d)) v for each head, over what is not in the future."""
    network = make(heads=heads)
    attention, size = network.blocks[0].attention, 24 // heads
    x = torch.randn(2, 7, 24, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        query, key, value = functional.linear(
            x, attention.query_key_value.weight, attention.query_key_value.bias
        ).chunk(3, dim=-1)
        of_heads = []
        for q, k, v in zip(query.split(size, -1), key.split(size, -1), value.split(size, -1), strict=True):
            rows = []
            for i in range(7):
                weights = torch.softmax(q[:, i : i + 1] @ k[:, : i + 1].mT / math.sqrt(size), dim=-1)
                rows.append(weights @ v[:, : i + 1])
            of_heads.append(torch.cat(rows, dim=1))
        expected = attention.output(torch.cat(of_heads, dim=-1))
        mask = network.mask[:7, :7]
        assert torch.allclose(attention(x, mask, ALL, None), expected, atol=1e-4)
        assert torch.allclose(attention(x, mask, slice(2, None, 2), None), expected[:, 2::2], atol=1e-4)


# FiLM


def test_film_starts_without_the_goal_and_can_learn_it():
    network, arguments = make("film"), inputs()
    other = [*arguments[:3], arguments[3].roll(1, dims=0)]
    with torch.no_grad():
        assert torch.equal(network(*arguments), network(*other))
    network(*arguments).square().sum().backward()
    assert all((block.film[-1].weight.grad != 0).any() for block in network.blocks)
    perturb_film(network)
    with torch.no_grad():
        assert (network(*arguments) - network(*other)).abs().amax(dim=2).min() > 1e-3


def test_film_has_more_parameters_but_no_positions_for_goals():
    film, sequential = make("film"), make()
    assert film.position.shape[1] == sequential.position.shape[1] - G
    assert parameters(film) > parameters(sequential)


def test_film_weights_can_be_saved():
    weights = make("film").state_dict()
    assert safetensors.torch.load(safetensors.torch.save(weights)).keys() == weights.keys()


# Configuration


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"heads": 5}, "heads = 5: must divide width = 24"),
        ({"layers": 0}, "layers = 0"),
        ({"window": 0}, "window = 0"),
        ({"attention_dropout": 1.0}, "attention_dropout = 1.0"),
        ({"residual_dropout": -0.1}, "residual_dropout = -0.1"),
    ],
)
def test_impossible_sizes_are_refused(changes, message):
    values = {"width": 24, "layers": 2, "heads": 4, "window": 5, "attention_dropout": 0.0, "residual_dropout": 0.0}
    with pytest.raises(ValueError, match=message):
        TransformerConfig(**{**values, **changes}, conditioning="sequential")
