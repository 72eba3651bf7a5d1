import itertools

import numpy as np

from beso.envs.calvin.simulator.observations import LIGHTBULB, SWITCH, block_slice
from beso.envs.calvin.simulator.spawn import CLOSED_FIXTURES, SURFACES, draw_fixtures, draw_scene


def test_blocks_lie_on_the_three_surfaces_equally_often():
    rng = np.random.default_rng(0)
    places = []
    for _ in range(300):
        scene = draw_scene(rng, CLOSED_FIXTURES)
        for block in range(3):
            x, y, z, *_ = scene[block_slice(block)]
            assert z == 0.46
            inside = [
                i
                for i, (low, high) in enumerate(SURFACES.values())
                if low[0] <= x <= high[0] and low[1] <= y <= high[1]
            ]
            assert len(inside) == 1
            places += inside
    assert np.bincount(places, minlength=3).min() > 240  # crowded surfaces are drawn again a little more often


def test_no_two_blocks_touch(table):
    rng = np.random.default_rng(1)
    for _ in range(30):
        table.reset(draw_scene(rng, draw_fixtures(rng)))
        blocks = table.state().blocks
        assert not any(b in blocks[a].touched for a, b in itertools.permutations(blocks, 2))


def test_lightbulb_agrees_with_its_switch():
    rng = np.random.default_rng(2)
    fixtures = np.array([draw_fixtures(rng) for _ in range(40)])
    assert ((fixtures[:, SWITCH] > 0.044) == (fixtures[:, LIGHTBULB] == 1)).all()
    assert (np.ptp(fixtures, axis=0) > 0)[[0, 1, 3, 4, 5]].all()
