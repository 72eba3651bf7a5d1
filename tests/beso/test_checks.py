import copy
import pickle

import numpy as np
import pytest

from beso.checks import not_copied, numbers
from beso.errors import UserError


@pytest.mark.parametrize("value", [[1, 2, 3], np.zeros(3, dtype=np.float32), (True, False, True)])
def test_numbers_of_the_shape_pass(value):
    assert numbers("it", value, (3,)).shape == (3,)
    assert numbers("it", [value], (3,), (None, 3)).shape == (1, 3)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ([1, 2], r"it has shape \(2,\), expected \(3,\) or \(any, 3\)"),
        (np.zeros((0, 3)), r"it has shape \(0, 3\), expected"),
        ([1.0, np.nan, 2.0], r"it holds nan at \[1\]: every number must be finite"),
        ([[0.0, 0.0, -np.inf]], r"it holds -inf at \[0, 2\]"),
        ([1j, 0, 0], "it holds complex128, expected real numbers"),
        (["a", "b", "c"], "it holds <U1, expected real numbers"),
        ([None] * 3, "it holds object, expected real numbers"),
        ([[1], [1, 2], [3]], "it is no array of numbers"),
        ({"observation": [1, 2, 3]}, "it is a dict, expected an array of shape"),
    ],
)
def test_anything_else_is_refused_in_one_line(value, message):
    with pytest.raises(UserError, match=message) as caught:
        numbers("it", value, (3,), (None, 3))
    assert len(str(caught.value).splitlines()) == 1


def test_what_is_not_copied_says_so():
    class Simulation:
        __reduce_ex__ = not_copied

    for copied in (copy.copy, copy.deepcopy, pickle.dumps):
        with pytest.raises(TypeError, match="a Simulation cannot be copied: make another"):
            copied(Simulation())
        with pytest.raises(TypeError, match="a Simulation cannot be copied"):
            copy.deepcopy({"inside": Simulation()})
