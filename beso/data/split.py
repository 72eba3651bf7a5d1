"""Which episodes of a play dataset a model is trained on."""

import numpy as np

from beso.seeding import generator


def split_episodes(episodes: int, train_fraction: float, root_seed: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Indices of training and held-out episodes of model number `seed`, in random order; at least one of each."""
    order = generator(root_seed, "split", seed).permutation(episodes)
    count = min(max(int(train_fraction * episodes), 1), episodes - 1)
    return order[:count], order[count:]
