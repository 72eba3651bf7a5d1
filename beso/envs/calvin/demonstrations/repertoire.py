"""What the scripted player can do next: skills by family, each only where it can succeed."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from beso.envs.calvin.demonstrations import block_skills, fixture_skills, placing_skills
from beso.envs.calvin.demonstrations.hand import Hand, Motion
from beso.envs.calvin.demonstrations.layout import (
    IN_DRAWER,
    IN_SLIDER,
    ON_BLOCK,
    ON_TABLE,
    below,
    can_push,
    can_push_into_drawer,
    clear_of_handle,
    free,
    free_spot,
    graspable,
    in_reach,
    others,
    place_of,
)
from beso.envs.calvin.observations import BLOCKS, DRAWER, LED, SLIDE, SWITCH, block_slice
from beso.envs.calvin.simulator.table import SLIDE_TRAVEL, SWITCH_TRAVEL

PARTIAL_SHARE = 0.15  # of the movements of drawer, door and blocks that stop halfway and complete no task


@dataclass(frozen=True)
class Skill:
    """One thing to do.

    Attributes:
        family: kind of skill; families are balanced.
        variant: which block, direction, ...; variants are balanced within a family.
        motion: makes its actions.
        held: the block that hangs in the gripper if it succeeds.
    """

    family: str
    variant: str
    motion: Callable[[Hand], Motion]
    held: int | None = None


def with_free_hand(scene: np.ndarray, rng: np.random.Generator) -> list[Skill]:
    """Everything that a hand without a block can do."""
    skills = [*_on_fixtures(scene, rng)]
    for block in range(len(BLOCKS)):
        skills += _with_block(scene, block, rng)
    return skills


def _on_fixtures(scene: np.ndarray, rng: np.random.Generator) -> Iterator[Skill]:
    amount = rng.uniform(0.05, 0.11) if rng.random() < PARTIAL_SHARE else rng.uniform(0.17, 0.25)
    if scene[DRAWER] < 0.13:
        yield Skill("drawer", "open", partial(fixture_skills.open_drawer, amount=amount))
    if scene[DRAWER] > 0.06:
        yield Skill("drawer", "close", partial(fixture_skills.close_drawer, amount=amount))
    amount = rng.uniform(0.06, 0.13) if rng.random() < PARTIAL_SHARE else SLIDE_TRAVEL
    if scene[SLIDE] < 0.18:
        yield Skill("slider", "left", partial(fixture_skills.move_slider, left=True, amount=amount))
    if scene[SLIDE] > 0.10:
        yield Skill("slider", "right", partial(fixture_skills.move_slider, left=False, amount=amount))
    yield Skill("button", "off" if scene[LED] else "on", fixture_skills.press_button)
    on = bool(scene[SWITCH] < SWITCH_TRAVEL / 2)
    yield Skill("switch", "on" if on else "off", partial(fixture_skills.move_switch, on=on))


def _with_block(scene: np.ndarray, block: int, rng: np.random.Generator) -> Iterator[Skill]:
    name, place = BLOCKS[block], place_of(scene, block)
    distance = rng.uniform(0.04, 0.09) if rng.random() < PARTIAL_SHARE else rng.uniform(0.115, 0.15)
    for right in (False, True):
        if can_push(scene, block, 1 if right else -1, distance):
            push = partial(block_skills.push, block=block, right=right, distance=distance)
            yield Skill("push", f"{name} {right}", push)
    if can_push_into_drawer(scene, block):
        yield Skill("push_into_drawer", name, partial(block_skills.push_into_drawer, block=block))
    if not graspable(scene, block):
        return
    if place == ON_TABLE:
        if clear_of_handle(scene, block):
            for left in (False, True):
                rotate = partial(block_skills.rotate, block=block, left=left, degrees=rng.uniform(70, 88))
                yield Skill("rotate", f"{name} {left}", rotate)
        yield Skill("lift_table", name, partial(block_skills.lift, block=block), held=block)
    elif place == ON_BLOCK and below(scene, block) is not None:
        yield Skill("unstack", name, partial(block_skills.lift, block=block), held=block)
    elif place == IN_SLIDER:
        yield Skill("lift_slider", name, partial(block_skills.lift_from_slider, block=block), held=block)
    elif place == IN_DRAWER:
        yield Skill("lift_drawer", name, partial(block_skills.lift_from_drawer, block=block), held=block)


def with_block(scene: np.ndarray, held: int, rng: np.random.Generator) -> list[Skill]:
    """Everything that can be done with the block in the gripper."""
    name = BLOCKS[held]
    skills = []
    spot = free_spot(scene, held, rng)
    if spot is not None:
        skills.append(Skill("put_on_table", name, partial(placing_skills.put_on_table, x=spot[0], y=spot[1])))
    places = [place_of(scene, other) for other in others(held)]
    compartment = placing_skills.open_compartment(scene[SLIDE])
    in_the_way = [
        place == IN_SLIDER and abs(scene[block_slice(other)][0] - compartment) < 0.1
        for other, place in zip(others(held), places, strict=True)
    ]
    if min(scene[SLIDE], SLIDE_TRAVEL - scene[SLIDE]) < 0.03 and not any(in_the_way):
        skills.append(Skill("place_in_slider", name, placing_skills.place_in_slider))
    if scene[DRAWER] > 0.16 and IN_DRAWER not in places:
        x = rng.uniform(0.1, 0.25)
        skills.append(Skill("place_in_drawer", name, partial(placing_skills.place_in_drawer, x=x)))
    for other, place in zip(others(held), places, strict=True):
        x, y = scene[block_slice(other)][:2]
        if place == ON_TABLE and free(scene, other) and clear_of_handle(scene, other) and in_reach(x, y):
            skills.append(Skill("stack", f"{name} {BLOCKS[other]}", partial(placing_skills.stack, below=other)))
    return skills
