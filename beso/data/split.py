"""Which episodes of a play dataset a model is trained on."""

import numpy as np

from beso.core.seeding import generator
from beso.data.play import split_episodes


def model_split(episodes: int, train_fraction: float, root_seed: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Indices of training and held-out ones of so many episodes, for model number `seed` (see split_episodes)."""
    return split_episodes(episodes, train_fraction, generator(root_seed, "split", seed))
