"""Who plays: what is begun at a wrong place, fails and is made good."""

import itertools

import numpy as np
import pytest

from beso.core.seeding import generator
from beso.envs.calvin.demonstrations import player as players
from beso.envs.calvin.demonstrations.hand import Hand
from beso.envs.calvin.demonstrations.oracle import perform
from beso.envs.calvin.demonstrations.player import ATTEMPTS, MISTAKE, Player, draw_start
from beso.envs.calvin.simulator.observations import BLOCKS, block_slice


@pytest.fixture(scope="module")
def played(table):
    """A row for each segment: its family, which attempt it was, metres of the mistake, and whether it failed."""
    rng = generator(3, "test of a player")
    table.reset(draw_start(rng))
    player, rows = Player(table, rng), []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(players, "MISTAKE_SHARE", 0.6)  # of few attempts enough shall fail
        for _ in range(60):
            segment = player.next_segment()
            perform(table, segment.motion)
            failed = player._last is not None and player._failed(player._last)
            rows.append((segment.family, player._attempts, np.linalg.norm(player.hand.mistake), failed))
    return rows


def test_some_first_attempts_are_made_at_a_wrong_place(played):
    lengths = np.array([length for _, attempt, length, _ in played if attempt == 1])
    assert 0.2 < (lengths > 0).mean() < 0.7  # none with a block in the hand
    assert MISTAKE[0] <= lengths[lengths > 0].min()
    assert lengths.max() <= MISTAKE[1]


def test_what_failed_is_tried_again_at_the_right_place(played):
    again = [row for row in played if row[1] > 1 and row[0] != "recover"]
    assert len(again) >= 3
    assert not any(length for _, _, length, _ in again)
    assert max(attempt for _, attempt, _, _ in again) <= ATTEMPTS
    assert not all(failed for _, _, _, failed in again)
    skills = [row for row in played if row[0] != "recover"]
    for before, after in itertools.pairwise(skills):
        if after[1] > 1:
            assert before[3]
            assert before[0] == after[0]


def test_a_hand_that_is_mistaken_takes_a_block_to_be_elsewhere(table, scene):
    table.reset(scene)
    hand = Hand(table)
    assert hand.block(0) == pytest.approx(table.scene_obs()[block_slice(0)])
    hand.mistake = np.array([0.03, 0.0, -0.01])
    for block in range(len(BLOCKS)):
        off = hand.block(block) - table.scene_obs()[block_slice(block)]
        assert off == pytest.approx([0.03, 0.0, -0.01, 0, 0, 0])


def test_a_hand_that_is_stopped_goes_on(table, scene):
    """Above the table it cannot go lower."""
    table.reset(scene)
    hand = Hand(table)
    perform(table, hand.go((0.2, -0.12, 0.47)))
    assert perform(table, hand.go((0.2, -0.12, 0.42), limit=60)) < 20
