"""The checks of all importers, on demonstrations of which a few numbers are changed."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beso import envs
from beso.envs import published
from beso.errors import UserError

STEPS, LARGEST = 5, {"observations": 2.0, "actions": 1.0}
numbers = st.one_of(st.floats(width=32), st.sampled_from([0.0, 1.0, -1.0, 2.0, 0.5]))
changes = st.lists(st.tuples(st.integers(0, 2), st.integers(0, STEPS - 1), st.integers(0, 10**3), numbers), max_size=3)


@pytest.mark.parametrize("name", envs.names())
@settings(max_examples=60, deadline=None)
@given(changes=changes)
def test_a_demonstration_passes_exactly_where_all_its_numbers_are_right(name, changes):
    spec = envs.spec(name)
    episode = [np.zeros((STEPS, width)) for width in (spec.observation_size, spec.action_size, len(spec.tasks))]
    episode[2][2, 0] = 1
    for part, step, column, value in changes:
        episode[part][step, column % episode[part].shape[1]] = value
    observations, actions, tasks = episode
    right = all(np.isfinite(part).all() for part in episode) and np.abs(observations).max() <= LARGEST["observations"]
    right = right and np.abs(actions).max() <= LARGEST["actions"] and np.isin(tasks, (0, 1)).all() and tasks.any()
    message = ""
    try:
        published.check((observations, actions, tasks), spec, LARGEST, "here")
    except UserError as error:
        message = str(error)
    assert right == (message == "")
    assert len(message.splitlines()) <= 1


@pytest.mark.parametrize("part", range(3))
def test_parts_of_different_lengths_or_widths_are_refused(part):
    spec = envs.spec(envs.names()[0])
    episode = [np.zeros((STEPS, width)) for width in (spec.observation_size, spec.action_size, len(spec.tasks))]
    episode[part] = episode[part][:, :-1]
    with pytest.raises(UserError, match=r"here: \w+ has shape"):
        published.check(tuple(episode), spec, LARGEST, "here")
