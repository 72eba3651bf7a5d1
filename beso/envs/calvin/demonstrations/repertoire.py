"""What the scripted player can do next: skills by family, each only where it can succeed."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from beso.envs.calvin.demonstrations import block_skills, fixture_skills, placing_skills
from beso.envs.calvin.demonstrations.grasps import find_grasp
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
    covered,
    free,
    free_spot,
    in_reach,
    others,
    place_of,
)
from beso.envs.calvin.simulator.observations import BLOCKS, DRAWER, LED, LIGHTBULB, SLIDE, SWITCH, block_slice
from beso.envs.calvin.simulator.table import SLIDE_TRAVEL, SWITCH_TRAVEL

PARTIAL_SHARE = 0.15  # of the movements of drawer, door and blocks that stop halfway and complete no task


@dataclass(frozen=True)
class Skill:
    """One thing to do.

    Attributes:
        family: kind of skill; families are balanced.
        variant: which block, direction, ...; variants are balanced within a family.
        motion: makes its actions.
        task: the task that it completes if it succeeds; None for those that complete none.
        held: the block that hangs in the gripper if it succeeds.
    """

    family: str
    variant: str
    motion: Callable[[Hand], Motion]
    task: str | None
    held: int | None = None


def with_free_hand(scene: np.ndarray, rng: np.random.Generator) -> list[Skill]:
    """Everything that a hand without a block can do."""
    skills = [*_on_fixtures(scene, rng)]
    for block in range(len(BLOCKS)):
        skills += _with_block(scene, block, rng)
    return skills


def _on_fixtures(scene: np.ndarray, rng: np.random.Generator) -> Iterator[Skill]:
    part = bool(rng.random() < PARTIAL_SHARE)
    amount = rng.uniform(0.05, 0.11) if part else rng.uniform(0.17, 0.25)
    if scene[DRAWER] < 0.13:
        whole = None if part or scene[DRAWER] > 0.08 else "open_drawer"
        yield Skill("drawer", "open", partial(fixture_skills.open_drawer, amount=amount), whole)
    if scene[DRAWER] > 0.06:
        whole = None if part or scene[DRAWER] < 0.14 else "close_drawer"
        yield Skill("drawer", "close", partial(fixture_skills.close_drawer, amount=amount), whole)
    part = bool(rng.random() < PARTIAL_SHARE)
    amount = rng.uniform(0.06, 0.13) if part else SLIDE_TRAVEL
    if scene[SLIDE] < 0.18:
        whole = None if part or scene[SLIDE] > 0.11 else "move_slider_left"
        yield Skill("slider", "left", partial(fixture_skills.move_slider, left=True, amount=amount), whole)
    if scene[SLIDE] > 0.10:
        whole = None if part or scene[SLIDE] < 0.17 else "move_slider_right"
        yield Skill("slider", "right", partial(fixture_skills.move_slider, left=False, amount=amount), whole)
    way = "off" if scene[LED] else "on"
    yield Skill("button", way, fixture_skills.press_button, f"turn_{way}_led")
    on = bool(scene[SWITCH] < SWITCH_TRAVEL / 2)
    way = "on" if on else "off"
    # A lightbulb that disagrees with its switch stays as it is.
    task = f"turn_{way}_lightbulb" if on is not bool(scene[LIGHTBULB]) else None
    yield Skill("switch", way, partial(fixture_skills.move_switch, on=on), task)


def _with_block(scene: np.ndarray, block: int, rng: np.random.Generator) -> Iterator[Skill]:
    name, place = BLOCKS[block], place_of(scene, block)
    colour = name.removeprefix("block_")
    part = bool(rng.random() < PARTIAL_SHARE)
    distance = rng.uniform(0.04, 0.09) if part else rng.uniform(0.115, 0.15)
    for way, side in (("left", -1), ("right", 1)):
        if can_push(scene, block, side, distance):
            push = partial(block_skills.push, block=block, right=side > 0, distance=distance)
            yield Skill("push", f"{name} {way}", push, None if part else f"push_{colour}_block_{way}")
    if can_push_into_drawer(scene, block):
        push = partial(block_skills.push_into_drawer, block=block)
        yield Skill("push_into_drawer", name, push, "push_into_drawer")
    if find_grasp(scene, block) is None:
        return
    if place == ON_TABLE and clear_of_handle(scene, block) and free(scene, block):
        for way in ("left", "right"):
            turn = partial(block_skills.rotate, block=block, left=way == "left", degrees=rng.uniform(70, 88))
            yield Skill("rotate", f"{name} {way}", turn, f"rotate_{colour}_block_{way}")
    if place == ON_BLOCK:
        if below(scene, block) is not None:
            yield Skill("unstack", name, partial(block_skills.lift, block=block), "unstack_block", held=block)
        return
    lift = {
        ON_TABLE: block_skills.lift,
        IN_SLIDER: block_skills.lift_from_slider,
        IN_DRAWER: block_skills.lift_from_drawer,
    }[place]
    yield Skill(f"lift_{place}", name, partial(lift, block=block), f"lift_{colour}_block_{place}", held=block)


def with_block(scene: np.ndarray, held: int, rng: np.random.Generator) -> list[Skill]:
    """Everything that can be done with the block in the gripper."""
    name = BLOCKS[held]
    skills = []
    spot = free_spot(scene, held, rng)
    if spot is not None:
        put = partial(placing_skills.put_on_table, x=spot[0], y=spot[1])
        skills.append(Skill("put_on_table", name, put, None))
    places = [place_of(scene, other) for other in others(held)]
    compartment = placing_skills.open_compartment(scene[SLIDE])
    in_the_way = any(
        place == IN_SLIDER and abs(scene[block_slice(other)][0] - compartment) < 0.1
        for other, place in zip(others(held), places, strict=True)
    )
    if min(scene[SLIDE], SLIDE_TRAVEL - scene[SLIDE]) < 0.03 and not in_the_way:
        skills.append(Skill("place_in_slider", name, placing_skills.place_in_slider, "place_in_slider"))
    if scene[DRAWER] > 0.16 and IN_DRAWER not in places:
        put = partial(placing_skills.place_in_drawer, x=rng.uniform(0.1, 0.25))
        skills.append(Skill("place_in_drawer", name, put, "place_in_drawer"))
    for other, place in zip(others(held), places, strict=True):
        x, y = scene[block_slice(other)][:2]
        if place == ON_TABLE and not covered(scene, other) and clear_of_handle(scene, other) and in_reach(x, y):
            put = partial(placing_skills.stack, below=other)
            skills.append(Skill("stack", f"{name} {BLOCKS[other]}", put, "stack_block"))
    return skills
