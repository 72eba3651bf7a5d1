"""The play table and the blocks, from primitives: names, frames, axes and limits of CALVIN's scene D.

World frame: x to the right of someone who faces the table, y away from them, z up; the table's top is at z = 0.44.
All lengths are world metres (see `urdf`).
"""

import math
from typing import Final

from beso.envs.calvin.simulator.urdf import (
    NO_ROTATION,
    box,
    cylinder,
    fixed,
    link,
    prismatic,
    robot,
    sphere,
    turned_box,
)

WOOD, LIGHT_WOOD = (0.45, 0.30, 0.18), (0.55, 0.38, 0.22)
HANDLE, BUTTON_BLACK, WHITE = (0.25, 0.25, 0.27), (0.02, 0.02, 0.02), (1.0, 1.0, 1.0)

TABLE_TOP: Final = 0.44
SLIDE_TRAVEL, DRAWER_TRAVEL, BUTTON_TRAVEL, SWITCH_TRAVEL = 0.28, 0.22, 0.02, 0.088
QUARTER_TURN = (math.pi / 2, 0.0, 0.0)  # about x: local y is up, local z is towards the person at the table
SLOPE: Final = math.radians(60)  # of the cabinet's front, in which the door slides

BLOCK_SIZES: Final = {  # metres
    "block_red": (0.056, 0.04, 0.04),
    "block_blue": (0.04, 0.04, 0.04),
    "block_pink": (0.08, 0.04, 0.04),
}
BLOCK_COLOURS: Final = {"block_red": (1.0, 0.0, 0.0), "block_blue": (0.0, 0.0, 1.0), "block_pink": (1.0, 0.0, 1.0)}
BLOCK_MASS: Final = 1.0  # kg
_BLOCK_CONTACT = '<contact><lateral_friction value="0.7"/><spinning_friction value="0.001"/></contact>'


def table_urdf() -> str:
    """The table: an immovable base, four sliding joints, two lights and the floor of the cabinet (the plank)."""
    parts = (_base(), _button(), _switch(), _door(), _drawer(), _lights(), _plank())
    return robot("play_table", "".join(parts))


def block_urdf(name: str) -> str:
    """One of the three free blocks, "block_red", "block_blue" or "block_pink"."""
    shape = turned_box(NO_ROTATION, BLOCK_SIZES[name], NO_ROTATION, BLOCK_COLOURS[name])
    return robot(name, link(name, BLOCK_MASS, shape, _BLOCK_CONTACT))


def _base() -> str:
    shapes = box((-0.44, -0.18, 0.40), (0.44, 0.02, TABLE_TOP), WOOD)
    # The slab is cut out below the plank: a block there would be 1 mm from it, which PyBullet reports as contact.
    shapes += box((-0.44, 0.02, 0.40), (0.44, 0.18, 0.415), WOOD)
    shapes += box((-0.44, 0.02, 0.415), (-0.36, 0.18, TABLE_TOP), WOOD)
    shapes += box((0.16, 0.02, 0.415), (0.44, 0.18, TABLE_TOP), WOOD)
    shapes += box((-0.44, 0.16, 0), (0.44, 0.18, 0.648), WOOD)  # board at the back
    for x in (-0.42, 0.42):
        for y in (-0.16, 0.16):
            shapes += box((x - 0.02, y - 0.02, 0), (x + 0.02, y + 0.02, 0.40), WOOD)  # legs
    # The drawer runs in the hollow between these two.
    shapes += box((-0.42, -0.16, 0.28), (-0.055, 0.16, 0.40), WOOD)
    shapes += box((0.41, -0.16, 0.28), (0.43, 0.16, 0.40), WOOD)
    shapes += _slope(0.20, 0.44) + _slope(-0.44, -0.36)
    shapes += box((-0.38, 0.115, 0.44), (-0.36, 0.16, 0.60), WOOD)  # the cabinet's two sides and its top
    shapes += box((0.19, 0.115, 0.44), (0.21, 0.16, 0.60), WOOD)
    shapes += box((-0.44, 0.138, 0.622), (0.44, 0.18, 0.648), WOOD)
    shapes += cylinder(0.043, 0.02, (-0.12, -0.12, 0.45), NO_ROTATION, LIGHT_WOOD)  # collar of the button
    return link("base_link", 0, shapes)


def _slope(left: float, right: float) -> str:
    """A closed piece of the cabinet's front."""
    length, thickness = 0.24, 0.02
    y = 0.08 + thickness / 2 * math.sin(SLOPE)
    z = 0.544 - thickness / 2 * math.cos(SLOPE)
    return turned_box(((left + right) / 2, y, z), (right - left, length, thickness), (SLOPE, 0.0, 0.0), LIGHT_WOOD)


def _button() -> str:
    shape = cylinder(0.034, 0.025, (0, 0.0125, 0), QUARTER_TURN, BUTTON_BLACK)
    joint = prismatic("base__button", "button_link", (-0.12, -0.12, 0.46), QUARTER_TURN, (0, -1, 0), BUTTON_TRAVEL)
    return link("button_link", 0.15, shape) + joint


def _switch() -> str:
    shapes = box((-0.060, 0.042, -0.024), (0.060, 0.064, 0.008), HANDLE)
    shapes += box((-0.060, 0, -0.024), (-0.040, 0.042, 0.008), HANDLE)
    shapes += box((0.040, 0, -0.024), (0.060, 0.042, 0.008), HANDLE)
    frame = (0.30, 0.060928, 0.49489), (math.radians(150), 0, 0)
    return link("switch_link", 0.24, shapes) + prismatic(
        "base__switch", "switch_link", *frame, (0, 0, -1), SWITCH_TRAVEL
    )


def _door() -> str:
    shapes = box((0, -0.12, 0), (0.28, 0.12, 0.022), LIGHT_WOOD)
    shapes += box((0.119, -0.08, 0.057), (0.161, 0.08, 0.080), HANDLE)
    shapes += box((0.119, -0.08, 0.022), (0.161, -0.058, 0.057), HANDLE)
    shapes += box((0.119, 0.058, 0.022), (0.161, 0.08, 0.057), HANDLE)
    frame = (-0.10, 0.075, 0.535264), (SLOPE, 0, 0)
    return link("slide_link", 1.54, shapes) + prismatic("base__slide", "slide_link", *frame, (-1, 0, 0), SLIDE_TRAVEL)


def _drawer() -> str:
    shapes = box((-0.221, -0.021, 0.157), (0.221, 0.081, 0.182), LIGHT_WOOD)  # front
    shapes += box((-0.20, 0, -0.061), (0.20, 0.021, 0.157), WOOD)  # floor and three walls
    shapes += box((-0.20, 0, -0.061), (-0.177, 0.081, 0.157), WOOD)
    shapes += box((0.177, 0, -0.061), (0.20, 0.081, 0.157), WOOD)
    shapes += box((-0.20, 0, -0.061), (0.20, 0.081, -0.038), WOOD)
    shapes += box((-0.12, 0.0196, 0.238), (0.12, 0.0601, 0.261), HANDLE)
    shapes += box((-0.12, 0.0196, 0.182), (-0.096, 0.0618, 0.238), HANDLE)
    shapes += box((0.096, 0.0196, 0.182), (0.12, 0.0618, 0.238), HANDLE)
    frame = (0.18, 0, 0.32), QUARTER_TURN
    return link("drawer_link", 4.23, shapes) + prismatic(
        "base__drawer", "drawer_link", *frame, (0, 0, 1), DRAWER_TRAVEL
    )


def _lights() -> str:
    led = link("led_link", 0.2, box((-0.082, 0, -0.022), (0.082, 0.018, 0.022), WHITE))
    bulb = link("light_link", 0.17, sphere(0.030, (0, 0.024, -0.028), WHITE))
    return (
        led
        + fixed("base__led", "led_link", (-0.12, 0.16, 0.648), QUARTER_TURN)
        + bulb
        + fixed("base__light", "light_link", (0.30, 0.132, 0.648), QUARTER_TURN)
    )


def _plank() -> str:
    shape = box((-0.26, 0, -0.07), (0.26, 0.021, 0.07), LIGHT_WOOD)
    return link("plank_link", 2.84, shape) + fixed("base__plank", "plank_link", (-0.10, 0.09, 0.42), QUARTER_TURN)
