"""Whatever is handed to a policy, it acts in finite numbers or says in one line why it cannot."""

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from beso.core.checkpoint import LoadedModel
from beso.data.scaling import Scaling
from beso.data.spec import Sizes
from beso.errors import UserError
from beso.methods import gcbc
from beso.policy import Policy

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
