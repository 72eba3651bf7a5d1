import re
from dataclasses import dataclass
from typing import Any, Literal

import pytest

from beso.config import build, require
from beso.errors import UserError


@dataclass(frozen=True)
class Inner:
    rate: float
    kind: Literal["a", "b"]

    def __post_init__(self):
        require(self.rate < 1, f"rate = {self.rate}: must be below 1")


@dataclass(frozen=True)
class Outer:
    count: int
    flag: bool
    text: str
    inner: Inner
    limit: int | None
    numbers: tuple[float, ...]
    table: dict[str, Inner]
    anything: Any
    optional: int = 3


GOOD = {
    "count": 2,
    "flag": True,
    "text": "x",
    "inner": {"rate": 0.5, "kind": "a"},
    "limit": None,
    "numbers": [1, 2.5],
    "table": {"k": {"rate": 0, "kind": "b"}},
    "anything": [1, {"z": 2}],
}


def refused(message, changes=None, without=()):
    values = {key: value for key, value in {**GOOD, **(changes or {})}.items() if key not in without}
    with pytest.raises(UserError, match=re.escape(message)) as caught:
        build(Outer, values, "p")
    assert len(str(caught.value).splitlines()) == 1


def test_builds_every_kind_of_field():
    built = build(Outer, GOOD, "p")
    expected_table = {"k": Inner(0.0, "b")}
    assert built == Outer(2, True, "x", Inner(0.5, "a"), None, (1.0, 2.5), expected_table, [1, {"z": 2}], 3)


def test_whole_numbers_are_numbers():
    with pytest.raises(UserError, match=r"p\.rate = 10+\.\.\.: expected a finite number"):
        build(Inner, {"rate": 10**400, "kind": "a"}, "p")
    built = build(Inner, {"rate": 0, "kind": "a"}, "p")
    assert isinstance(built.rate, float)


def test_defaults_and_optional_values():
    assert build(Outer, {**GOOD, "optional": 7, "limit": 5}, "p") == Outer(
        **{**build(Outer, GOOD, "p").__dict__, "optional": 7, "limit": 5}
    )


def test_unknown_keys_are_refused_with_the_allowed_ones():
    refused("p.inner.rat = 1: unknown key; allowed are rate, kind", {"inner": {"rat": 1, "rate": 0.5, "kind": "a"}})
    refused("p.spare = None: unknown key", {"spare": None})
    refused("p.3 = 'x': unknown key", {3: "x"})


def test_missing_keys_are_refused_with_what_is_expected():
    refused("p.count is missing: expected an integer", without=["count"])
    refused("p.limit is missing: expected an integer or null", without=["limit"])
    refused("p.numbers is missing: expected a list, each item a finite number", without=["numbers"])
    refused("p.table is missing: expected a mapping", without=["table"])
    refused("p.inner.kind is missing: expected one of a, b", {"inner": {"rate": 0.5}})


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("count", True, "an integer"),  # bool is a kind of int in Python, not in a configuration
        ("count", 2.0, "an integer"),
        ("count", "2", "an integer"),
        ("count", None, "an integer"),
        ("flag", 1, "true or false"),
        ("flag", "yes", "true or false"),
        ("text", 1, "text"),
        ("limit", "none", "an integer"),
        ("limit", False, "an integer"),
        ("inner", 5, "a mapping"),
        ("inner", [0.5, "a"], "a mapping"),
        ("numbers", 1.0, "a list, each item a finite number"),
        ("numbers", "12", "a list, each item a finite number"),
        ("table", [1], "a mapping"),
    ],
)
def test_wrong_types_are_refused_with_key_value_and_what_is_expected(key, value, expected):
    refused(f"p.{key} = {value!r}: expected {expected}", {key: value})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"inner": {"rate": "1e-4", "kind": "a"}}, "p.inner.rate = '1e-4': expected a finite number"),
        ({"inner": {"rate": True, "kind": "a"}}, "p.inner.rate = True: expected a finite number"),
        ({"inner": {"rate": 0.5, "kind": "c"}}, "p.inner.kind = 'c': expected one of a, b"),
        ({"inner": {"rate": 0.5, "kind": None}}, "p.inner.kind = None: expected one of a, b"),
        ({"numbers": [1, "x"]}, "p.numbers[1] = 'x': expected a finite number"),
        ({"table": {"k": {"rate": 0.5, "kind": "c"}}}, "p.table.k.kind = 'c': expected one of a, b"),
    ],
)
def test_mistakes_inside_are_named_with_their_whole_key(changes, message):
    refused(message, changes)


def test_a_value_that_the_class_refuses_is_named_with_its_place():
    refused("p.inner: rate = 1.5: must be below 1", {"inner": {"rate": 1.5, "kind": "a"}})


@pytest.mark.parametrize("values", [None, 3, "x", [1]])
def test_something_else_than_a_mapping_is_refused(values):
    with pytest.raises(UserError, match="expected a mapping"):
        build(Outer, values, "p")


def test_a_long_wrong_value_is_cut():
    with pytest.raises(UserError) as error:
        build(Outer, "x" * 10_000, "p")
    assert str(error.value) == f"p = {repr('x' * 10_000)[:80]}...: expected a mapping"


@dataclass(frozen=True)
class Sizes:
    batch_size: int = 1
    batches: tuple[int, ...] = ()
    size: int | None = None


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"batch_size": 10**12}, "p.batch_size = 1000000000000: must be at most 1048576"),
        ({"batches": [1, 10**9]}, "p.batches = (1, 1000000000): must be at most 1048576"),
        ({"size": 10**400}, "p.size = 1" + "0" * 79 + "...: must be at most 4096"),
    ],
)
def test_numbers_that_cannot_be_meant_are_refused(values, message):
    with pytest.raises(UserError) as caught:
        build(Sizes, values, "p")
    assert str(caught.value) == message
    assert build(Sizes, {"batch_size": 1 << 20, "size": None}, "p").batch_size == 1 << 20
