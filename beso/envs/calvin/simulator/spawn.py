"""Random scenes by CALVIN's rule: each block on one of three surfaces, turned at random, no two blocks touching."""

import itertools
import math
from typing import Final

import numpy as np

from beso.envs.calvin.simulator.observations import BLOCKS, SCENE_SIZE, block_slice
from beso.envs.calvin.simulator.table import BLOCK_SIZES, SLIDE_TRAVEL, SWITCH_TRAVEL

SURFACES: Final = {  # (low, high) of the blocks' centres, x and y, metres
    "table": ((0.0, -0.15), (0.35, -0.03)),
    "slider_left": ((-0.32, 0.05), (-0.16, 0.12)),
    "slider_right": ((-0.05, 0.05), (0.13, 0.12)),  # behind the door when it is at 0
}
BLOCK_HEIGHT: Final = 0.46  # m, of a block's centre
OPEN_DRAWER: Final = 0.2  # m
GAP: Final = 0.01  # m between two blocks; CALVIN's test is contact, which PyBullet reports a little before touching
CLOSED_FIXTURES: Final = (0.0,) * 6  # everything closed and off: how CALVIN starts


def draw_fixtures(rng: np.random.Generator) -> np.ndarray:
    """Door, drawer, switch and lights each in one of their two states, (6,); the lightbulb agrees with the switch."""
    slide, drawer, switch, led = rng.integers(2, size=4)
    return np.array([slide * SLIDE_TRAVEL, drawer * OPEN_DRAWER, 0, switch * SWITCH_TRAVEL, switch, led], dtype=float)


def draw_scene(rng: np.random.Generator, fixtures: np.ndarray | tuple[float, ...]) -> np.ndarray:
    """A scene_obs (24,) with these `fixtures` (6,) and blocks drawn at random."""
    scene = np.zeros(SCENE_SIZE)
    scene[:6] = fixtures
    while True:
        for block in range(len(BLOCKS)):
            low, high = SURFACES[list(SURFACES)[rng.integers(len(SURFACES))]]
            xy, yaw = rng.uniform(low, high), rng.uniform(-math.pi, math.pi)
            scene[block_slice(block)] = (*xy, BLOCK_HEIGHT, 0, 0, yaw)
        if not any(_touch(scene, a, b) for a, b in itertools.combinations(range(len(BLOCKS)), 2)):
            return scene


def _touch(scene: np.ndarray, first: int, second: int) -> bool:
    """Whether two blocks come nearer than GAP: rectangles are apart if an edge's direction separates them."""
    corners = [_corners(scene, block) for block in (first, second)]
    for block in (first, second):
        yaw = scene[block_slice(block)][5]
        for angle in (yaw, yaw + math.pi / 2):
            axis = np.array([math.cos(angle), math.sin(angle)])
            a, b = (points @ axis for points in corners)
            if a.max() + GAP < b.min() or b.max() + GAP < a.min():
                return False
    return True


def _corners(scene: np.ndarray, block: int) -> np.ndarray:
    """The four corners of a block seen from above, (4, 2) metres."""
    x, y, _, _, _, yaw = scene[block_slice(block)]
    length, width, _ = BLOCK_SIZES[BLOCKS[block]]
    along, across = np.array([math.cos(yaw), math.sin(yaw)]), np.array([-math.sin(yaw), math.cos(yaw)])
    return np.array([(x, y) + s * length / 2 * along + t * width / 2 * across for s in (-1, 1) for t in (-1, 1)])
