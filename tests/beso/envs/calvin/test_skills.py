"""Every scripted skill does its task, judged by the task's published criterion."""

import numpy as np
import pytest

from beso.envs.calvin.demonstrations import block_skills, fixture_skills, placing_skills
from beso.envs.calvin.demonstrations.hand import Hand
from beso.envs.calvin.observations import FIXTURES, block_slice
from beso.envs.calvin.simulator.play_table import PlayTable
from beso.envs.calvin.tasks import completed, names_of

REST = np.array([0, 0, 0, 0, 0, 0, 1.0])
PLACES = {0: (0.05, -0.10), 1: (0.17, -0.08), 2: (0.30, -0.10)}  # of red, blue and pink, metres
SLIDE_LEFT, DRAWER_OPEN, SWITCHED = (0, 0.28), (1, 0.2), (3, 0.088)


@pytest.fixture(scope="module")
def table():
    table = PlayTable()
    yield table
    table.close()


def start(table, changes=(), seed=0):
    """All blocks on the table at slightly drawn places; some fixtures as told."""
    rng = np.random.default_rng(seed)
    scene = np.zeros(24)
    for index, value in changes:
        scene[FIXTURES.start + index] = value
    if SWITCHED in changes:
        scene[4] = 1
    for block, (x, y) in PLACES.items():
        scene[block_slice(block)] = (*(rng.uniform(-0.01, 0.01, 2) + (x, y)), 0.46, 0, 0, rng.uniform(-0.3, 0.3))
    table.reset(scene)
    table.step(REST)
    return Hand(table, rng)


def tasks_of(table, motion):
    before, seen = table.state(), set()
    for action in motion:
        table.step(action)
        seen |= set(names_of(completed(before, table.state())))
    return seen


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize(
    ("task", "changes", "skill"),
    [
        ("open_drawer", (), lambda hand: fixture_skills.open_drawer(hand)),
        ("close_drawer", (DRAWER_OPEN,), lambda hand: fixture_skills.close_drawer(hand)),
        ("move_slider_left", (), lambda hand: fixture_skills.move_slider(hand, left=True)),
        ("move_slider_right", (SLIDE_LEFT,), lambda hand: fixture_skills.move_slider(hand, left=False)),
        ("turn_on_led", (), lambda hand: fixture_skills.press_button(hand)),
        ("turn_off_led", ((5, 1),), lambda hand: fixture_skills.press_button(hand)),
        ("turn_on_lightbulb", (), lambda hand: fixture_skills.move_switch(hand, on=True)),
        ("turn_off_lightbulb", (SWITCHED,), lambda hand: fixture_skills.move_switch(hand, on=False)),
        ("lift_blue_block_table", (), lambda hand: block_skills.lift(hand, 1)),
        ("rotate_red_block_left", (), lambda hand: block_skills.rotate(hand, 0, left=True)),
        ("rotate_red_block_right", (), lambda hand: block_skills.rotate(hand, 0, left=False)),
    ],
)
def test_a_skill_does_its_task(table, task, changes, skill, seed):
    assert task in tasks_of(table, skill(start(table, changes, seed)))


@pytest.mark.parametrize(
    ("task", "changes", "skill"),
    [
        ("place_in_drawer", (DRAWER_OPEN,), lambda hand: placing_skills.place_in_drawer(hand)),
        ("place_in_slider", (), lambda hand: placing_skills.place_in_slider(hand)),
        ("stack_block", (), lambda hand: placing_skills.stack(hand, 2)),
    ],
)
def test_a_lifted_block_can_be_placed(table, task, changes, skill):
    hand = start(table, changes)
    first = table.state()
    tasks_of(table, block_skills.lift(hand, 1))
    held = tasks_of(table, skill(hand))
    stacked = names_of(completed(first, table.state()))  # judged from before the lift
    assert task in held | set(stacked)
