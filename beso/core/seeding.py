"""Explicit random generators. Nothing in this library draws from a global one.

Every stream is named by (root seed, role, index...): the role says what the numbers are for, the indices say for
which seed, episode or chunk. Streams of different names are independent (numpy.random.SeedSequence), so episode 7
gets the same numbers whether or not episodes 0 to 6 were played, and in whichever process.
"""

import zlib

import numpy as np
import torch


def seed_sequence(root: int, role: str, *index: int) -> np.random.SeedSequence:
    """The seed sequence of one named stream."""
    return np.random.SeedSequence(entropy=root, spawn_key=(zlib.crc32(role.encode()), *index))


def generator(root: int, role: str, *index: int) -> np.random.Generator:
    """A numpy generator for one named stream."""
    return np.random.default_rng(seed_sequence(root, role, *index))


def integer_seed(root: int, role: str, *index: int) -> int:
    """A 63-bit seed for libraries that take an integer (gymnasium, torch)."""
    return int(seed_sequence(root, role, *index).generate_state(1, np.uint64)[0] >> 1)


def torch_generator(root: int, role: str, *index: int, device: str | torch.device = "cpu") -> torch.Generator:
    """A torch generator on `device` for one named stream."""
    return torch.Generator(device=device).manual_seed(integer_seed(root, role, *index))
