import numpy as np
import pytest

from beso.envs.calvin.simulator.observations import block_slice
from beso.envs.calvin.simulator.play_table import PlayTable


@pytest.fixture(scope="module")
def table():
    table = PlayTable()
    yield table
    table.close()


@pytest.fixture
def scene():
    """Everything closed and off; red, blue and pink block side by side on the table."""
    scene = np.zeros(24)
    for block, x in enumerate((0.02, 0.14, 0.27)):
        scene[block_slice(block)] = x, -0.11, 0.46, 0, 0, np.pi / 2
    return scene
