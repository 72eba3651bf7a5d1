"""How far off a thing may be believed to be for the scripted player to do its task all the same.

    python -m beso.envs.kitchen.demonstrations.tolerance [TRIALS]

prints, for every skill and mode, how many of TRIALS single attempts succeed. A policy that imitates the player is a
centimetre or two off, so that what it learns of a skill without tolerance it cannot do.
"""

import sys

from beso.core.seeding import generator
from beso.envs.kitchen.demonstrations.player import Player, direction
from beso.envs.kitchen.demonstrations.skills import SKILLS
from beso.envs.kitchen.simulator import KitchenEnv
from beso.envs.kitchen.spec import TASKS
from beso.errors import UserError

MISTAKES = (0.0, 0.01, 0.02, 0.03)  # m
TRIALS = 30


def successes(env: KitchenEnv, task: int, mode: str, mistake: float, trials: int) -> int:
    """How many of some single attempts do a task when the thing is `mistake` metres off in a random direction."""
    return sum(_attempt(env, task, mode, mistake, trial) for trial in range(trials))


def _attempt(env: KitchenEnv, task: int, mode: str, mistake: float, trial: int) -> bool:
    rng = generator(0, "kitchen tolerance", task, trial)
    offset = mistake * direction(rng)
    return Player(env, rng).do(task, mode, attempts=1, mistake=offset)


def main(arguments: list[str]) -> None:
    """Print the table. Raises UserError if the number of trials is none."""
    given = arguments[0] if arguments else str(TRIALS)
    if len(arguments) > 1 or not given.isdecimal() or int(given) == 0:
        raise UserError(f"{' '.join(arguments)!r} is not a number of trials")
    env, trials = KitchenEnv(), int(given)
    print(f"{'':16}{'':12}" + "".join(f"{100 * mistake:>4.0f} cm" for mistake in MISTAKES))
    for task, skill in SKILLS.items():
        for mode in skill.modes:
            found = [successes(env, task, mode, mistake, trials) for mistake in MISTAKES]
            print(f"{TASKS[task].name:16}{mode:12}" + "".join(f"{count:>7}" for count in found), flush=True)


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except UserError as error:
        sys.exit(str(error))
