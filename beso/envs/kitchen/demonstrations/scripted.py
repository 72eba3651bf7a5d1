"""Scripted demonstrations of the relay kitchen in place of the human ones.

Each does four of the seven tasks: one of the 24 sets of tasks that people were asked for (Gupta et al. 2019), all
equally likely, in the order in which they did them. A demonstration ends when the hand has withdrawn from the last
thing, a dozen steps after the last task is done, as the human ones do: in its last states all four tasks are done, so
that they can serve as a goal.
"""

import functools
import itertools
from typing import Any

import numpy as np

from beso.core.seeding import generator
from beso.data.play import Episode
from beso.envs.kitchen.demonstrations.player import LIMIT, Player
from beso.envs.kitchen.simulator import KitchenEnv
from beso.envs.kitchen.spec import MICROWAVE, TASKS

LETTERS = {task.letter: index for index, task in enumerate(TASKS)}
HUMAN_TASK_SETS = tuple(
    tuple(LETTERS[letter] for letter in name)
    for line in (
        "mkbs mkbh mkth mktl mkls mklh mksh mbth mbts mbtl mbls mbsh",
        "mtlh mlsh kbts kbth kbtl kbls kblh kbsh ktls klsh btls btsh",
    )
    for name in line.split()
)
MOST_TAKES = 20


def record(seed: int, index: int) -> Episode:
    """Record demonstration `index` of the data set with root seed `seed`.

    A take in which not exactly the wanted tasks are done, or not within 280 actions, is dropped and the next one is
    played with numbers of its own. The set of tasks stays, so that difficult ones are not rarer than others.

    Returns:
        T steps: noisy observations (T, 30), the actions taken there (T, 9), and 1 in the first state in which a task
        is done (T, 7).
    """
    return _episode(*play(_recording_environment(), seed, index))


def film(seed: int) -> tuple[list[np.ndarray], dict[str, Any]]:
    """Pictures of the miss in demonstration `filmed(seed)`, and what they show (beso.envs.protocol.Filmer)."""
    index, take = filmed(seed)
    env = KitchenEnv(render_mode="rgb_array")
    player = Player(env, _draws(seed, index, take))
    player.do(MICROWAVE)
    env.close()
    shows = "the hand misses the microwave's handle by some centimetres, tries again, and opens it"
    return player.pictures, {"demonstration": index, "shows": shows}


def filmed(seed: int) -> tuple[int, int]:
    """The first demonstration in which the microwave is missed and then opened, and its take.

    The microwave is always the first task. The camera sees no mistake better.
    """
    played = ((index, *play(_recording_environment(), seed, index)) for index in itertools.count())
    return next((index, take) for index, player, take in played if MICROWAVE in player.made_good)


def play(env: KitchenEnv, seed: int, index: int) -> tuple[Player, int]:
    """The take that is a demonstration, and the number of those before it."""
    wanted = task_set(seed, index)
    for take in range(MOST_TAKES):
        player = Player(env, _draws(seed, index, take))
        if perform(player, wanted):
            return player, take
    raise RuntimeError(f"demonstration {index} of seed {seed} failed {MOST_TAKES} times")


def _draws(seed: int, index: int, take: int) -> np.random.Generator:
    """For a take; it depends on these numbers alone."""
    return generator(seed, "kitchen demonstration", index, take)


def task_set(seed: int, index: int) -> tuple[int, ...]:
    """The tasks of a demonstration, in the order in which they are done."""
    rng = generator(seed, "kitchen demonstration tasks", index)
    return HUMAN_TASK_SETS[rng.integers(len(HUMAN_TASK_SETS))]


def perform(player: Player, wanted: tuple[int, ...]) -> bool:
    """Play one take; whether it is a demonstration of the wanted tasks."""
    for task in wanted:
        player.do(task)
    # The state after the last action is not part of a demonstration.
    last, steps = player.done[-2], len(player.actions)
    return player.completed == wanted and steps <= LIMIT and bool(last[list(wanted)].all())


def _episode(player: Player, failed_takes: int) -> Episode:
    steps, states = len(player.actions), np.stack(player.done[:-1])
    first = (states & (states.cumsum(axis=0) == 1)).astype(np.uint8)
    return Episode(
        np.stack(player.observations[:steps]).astype(np.float32), np.stack(player.actions), first, failed_takes
    )


@functools.cache
def _recording_environment() -> KitchenEnv:
    """One environment a process; an episode depends on its reset alone, not on those played before."""
    return KitchenEnv()
