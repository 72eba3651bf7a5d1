"""Every task: what completes it, and what only nearly does."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from beso.envs.calvin.simulator.state import BlockState, TableState
from beso.envs.calvin.simulator.tasks import NAMES, completed, names_of, turn

CALVINS_ORDER = (
    "rotate_red_block_right",
    "rotate_red_block_left",
    "rotate_blue_block_right",
    "rotate_blue_block_left",
    "rotate_pink_block_right",
    "rotate_pink_block_left",
    "push_red_block_right",
    "push_red_block_left",
    "push_blue_block_right",
    "push_blue_block_left",
    "push_pink_block_right",
    "push_pink_block_left",
    "move_slider_left",
    "move_slider_right",
    "open_drawer",
    "close_drawer",
    "lift_red_block_table",
    "lift_red_block_slider",
    "lift_red_block_drawer",
    "lift_blue_block_table",
    "lift_blue_block_slider",
    "lift_blue_block_drawer",
    "lift_pink_block_table",
    "lift_pink_block_slider",
    "lift_pink_block_drawer",
    "place_in_slider",
    "place_in_drawer",
    "stack_block",
    "unstack_block",
    "turn_on_lightbulb",
    "turn_off_lightbulb",
    "turn_on_led",
    "turn_off_led",
    "push_into_drawer",
)
COLOURS = ("red", "blue", "pink")
REST = (0.0,) * 6


def block(x=0.1, z=0.46, yaw=0.0, links=("base_link",), bodies=(), roll=0.0, velocity=REST):
    """A block; `links` of the table and other `bodies` touch it."""
    touched = frozenset(bodies) | (frozenset({"table"}) if links else frozenset())
    quaternion = tuple(Rotation.from_euler("xyz", [roll, 0, yaw], degrees=True).as_quat())
    return BlockState((x, -0.1, z), quaternion, velocity, touched, frozenset(links))


def state(robot=(), **changes):
    """A table at rest; block_red=..., slide=... change it."""
    blocks = {f"block_{colour}": changes.pop(f"block_{colour}", block()) for colour in COLOURS}
    values = {"slide": 0.1, "drawer": 0.1, "lightbulb": False, "led": False, **changes}
    return TableState(blocks=blocks, touched_by_robot=frozenset(robot), **values)


def done(start, end):
    return names_of(completed(start, end))


def held(**place):
    return block(links=(), bodies=("robot",), **place)


def test_names_are_calvins():
    assert NAMES == CALVINS_ORDER


def test_nothing_is_done_when_nothing_happens():
    assert done(state(), state()) == ()


@pytest.mark.parametrize("colour", COLOURS)
class TestBlocks:
    def one(self, colour, **place):
        return state(**{f"block_{colour}": block(**place)})

    def test_rotation(self, colour):
        start = self.one(colour, yaw=20)
        assert done(start, self.one(colour, yaw=81)) == (f"rotate_{colour}_block_left",)
        assert done(start, self.one(colour, yaw=-41)) == (f"rotate_{colour}_block_right",)
        assert done(start, self.one(colour, yaw=79)) == ()
        assert done(start, self.one(colour, yaw=-39)) == ()
        assert done(start, self.one(colour, yaw=100, x=0.19)) == (f"rotate_{colour}_block_left",)
        assert done(start, self.one(colour, yaw=100, x=0.21)) == (f"push_{colour}_block_right",)  # moved too far
        assert done(start, self.one(colour, yaw=100, roll=40)) == ()
        in_hand = state(**{f"block_{colour}": held(yaw=100)})
        assert done(start, in_hand) == ()
        touched = self.one(colour, yaw=100, bodies=("robot",))
        assert done(start, touched) == (f"rotate_{colour}_block_left",)

    def test_push(self, colour):
        start = self.one(colour)
        assert done(start, self.one(colour, x=0.201)) == (f"push_{colour}_block_right",)
        assert done(start, self.one(colour, x=-0.001)) == (f"push_{colour}_block_left",)
        assert done(start, self.one(colour, x=0.199)) == ()
        assert done(start, self.one(colour, x=0.3, links=())) == ()
        pushed = self.one(colour, x=0.3, bodies=("robot",))
        assert done(start, pushed) == (f"push_{colour}_block_right",)
        assert done(pushed, self.one(colour)) == (f"push_{colour}_block_left",)

    def test_push_ends_on_all_that_the_block_was_on(self, colour):
        right = (f"push_{colour}_block_right",)
        on_table, beside = self.one(colour), self.one(colour, bodies=("block_other",))
        assert done(on_table, self.one(colour, x=0.3, bodies=("block_other",))) == right
        assert done(on_table, self.one(colour, x=0.3, links=("base_link", "plank_link"))) == right
        assert done(on_table, self.one(colour, x=0.3, links=("plank_link",))) == ()  # the table, another link
        assert done(self.one(colour, links=("base_link", "switch_link")), self.one(colour, x=0.3)) == ()
        assert done(beside, self.one(colour, x=0.3)) == ()
        assert done(beside, self.one(colour, x=0.3, bodies=("block_third",))) == ()
        assert done(beside, self.one(colour, x=0.3, bodies=("block_other",))) == right
        in_hand = state(**{f"block_{colour}": held()})
        assert done(in_hand, self.one(colour, x=0.3)) == ()

    @pytest.mark.parametrize(
        ("place", "link", "height"),
        [("table", "base_link", 0.05), ("slider", "plank_link", 0.03), ("drawer", "drawer_link", 0.05)],
    )
    def test_lift(self, colour, place, link, height):
        start = self.one(colour, links=(link,))

        def end(block):
            return state(**{f"block_{colour}": block})

        assert done(start, end(held(z=0.461 + height))) == (f"lift_{colour}_block_{place}",)
        assert done(start, end(held(z=0.459 + height))) == ()
        scraping = block(z=0.6, links=("base_link",), bodies=("robot",))
        assert done(start, end(scraping)) == ()
        on_another = block(z=0.6, links=(), bodies=("block_other", "robot"))
        assert done(start, end(on_another)) == ()
        grasped = self.one(colour, links=(link,), bodies=("robot",))
        assert done(grasped, end(held(z=0.6))) == (f"lift_{colour}_block_{place}",)
        assert done(end(held(z=0.46)), end(held(z=0.6))) == ()  # in the air from the start
        elsewhere = self.one(colour, links=("button_link",), bodies=("robot",))
        assert done(elsewhere, end(held(z=0.6))) == ()


@pytest.mark.parametrize(
    ("joint", "threshold", "up", "down"),
    [("slide", 0.15, "move_slider_left", "move_slider_right"), ("drawer", 0.12, "open_drawer", "close_drawer")],
)
def test_doors(joint, threshold, up, down):
    low, high = state(**{joint: 0.02}), state(**{joint: 0.021 + threshold})
    near = state(**{joint: 0.019 + threshold})
    assert done(low, high) == (up,)
    assert done(high, low) == (down,)
    assert done(low, near) == ()
    assert done(near, low) == ()


@pytest.mark.parametrize("light", ["lightbulb", "led"])
def test_lights(light):
    off, on = state(**{light: False}), state(**{light: True})
    assert done(off, on) == (f"turn_on_{light}",)
    assert done(on, off) == (f"turn_off_{light}",)
    assert done(on, on) == ()


@pytest.mark.parametrize(("place", "link"), [("slider", "plank_link"), ("drawer", "drawer_link")])
def test_place(place, link):
    task = (f"place_in_{place}",)
    start = state(robot={"block_blue"}, block_blue=held(z=0.55))
    assert done(start, state(block_blue=block(links=(link,)))) == task
    assert done(start, state(block_blue=block(links=("base_link",)))) == ()
    still_held = state(robot={"block_blue"}, block_blue=block(links=(link,), bodies=("robot",)))
    assert done(start, still_held) == ()
    end = state(block_blue=block(links=(link,)))
    assert done(replace(start, touched_by_robot=frozenset({"block_blue", "table"})), end) == ()
    assert done(replace(start, touched_by_robot=frozenset({"table"})), end) == ()
    dragging = state(robot={"block_blue"}, block_blue=block(bodies=("robot",)))
    assert done(dragging, end) == ()


def test_stack_and_unstack():
    apart = state()
    upper = block(z=0.5, links=(), bodies=("block_blue",))
    lower = block(bodies=("block_red",))
    stacked = state(block_red=upper, block_blue=lower)
    assert done(apart, stacked) == ("stack_block",)
    assert done(stacked, apart) == ("unstack_block",)
    moving = replace(upper, velocity=(0, 0, -1.1, 0, 0, 0))
    assert done(apart, state(block_red=moving, block_blue=lower)) == ()
    assert done(state(block_red=moving, block_blue=lower), apart) == ()
    leaning = replace(upper, touched=frozenset({"block_blue", "table"}))
    assert done(apart, state(block_red=leaning, block_blue=lower)) == ()
    in_hand = replace(upper, touched=frozenset({"block_blue", "robot"}))
    assert done(apart, state(block_red=in_hand, block_blue=lower)) == ()


def test_push_into_drawer():
    start = state()
    inside = block(z=0.36, links=("drawer_link",))
    task = ("push_into_drawer",)
    assert done(start, state(block_pink=inside)) == task
    for body in ("robot", "block_red"):
        assert done(start, state(block_pink=replace(inside, touched=frozenset({"table", body})))) == task
    assert done(start, state(block_pink=block(z=0.36, links=("base_link",)))) == ()
    assert done(start, state(block_pink=held(z=0.36))) == ()
    touched = state(block_pink=block(bodies=("robot",)))
    assert done(touched, state(block_pink=inside)) == ()
    beside_another = state(block_pink=block(bodies=("block_red",)))
    assert done(beside_another, state(block_pink=inside)) == ()
    from_plank = state(block_pink=block(links=("plank_link",)))
    assert done(from_plank, state(block_pink=inside)) == ()


def test_turn_is_scipys():
    rng = np.random.default_rng(0)
    for _ in range(20):
        before, after = Rotation.random(2, rng=rng)
        expected = (after * before.inv()).as_euler("xyz", degrees=True)
        assert turn(tuple(before.as_quat()), tuple(after.as_quat())) == pytest.approx(expected, abs=1e-6)
    assert math.isclose(turn((0, 0, 0, 1), (0, 0, math.sqrt(0.5), math.sqrt(0.5)))[2], 90)
