"""URDF and mesh files of the block-push scene, written from primitives.

The arm and the ground come from pybullet_data; blocks, target zones, the work surface and the pushing tool are
authored here. Dimensions are metres, masses kilograms. PyBullet recomputes inertia from the collision shape, so the
unit inertia in the files has no effect.
"""

import math
from pathlib import Path

RED, GREEN = "1 0.34 0.35 1", "0.34 1 0.35 1"
DARK_GREY, BLUE = "0.2 0.2 0.2 1", "0.18 0.51 0.77 1"

BLOCK_SIZE = 0.04
BLOCK_MASS = 0.01
ZONE_SIZE, ZONE_WALL, ZONE_HEIGHT = 0.12, 0.006, 0.001
SHAFT_RADIUS, SHAFT_LENGTH, SHAFT_SIDES = 0.005, 0.03, 64
NEEDLE_RADIUS, NEEDLE_LENGTH, NEEDLE_OFFSET = 0.001, 0.028, 0.029

_CONTACT = (
    '<contact><lateral_friction value="1.0"/><rolling_friction value="0.0001"/><inertia_scaling value="3.0"/></contact>'
)


def _robot(name: str, body: str) -> str:
    return f'<?xml version="1.0"?>\n<robot name="{name}">{body}</robot>\n'


def _link(name: str, mass: float, body: str, contact: str = "") -> str:
    inertia = '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
    return f'<link name="{name}">{contact}<inertial><mass value="{mass}"/>{inertia}</inertial>{body}</link>'


def _visual(geometry: str, colour: str, xyz: str = "0 0 0") -> str:
    material = f'<material name="colour"><color rgba="{colour}"/></material>'
    return f'<visual><origin xyz="{xyz}"/><geometry>{geometry}</geometry>{material}</visual>'


def _collision(geometry: str, xyz: str = "0 0 0") -> str:
    return f'<collision><origin xyz="{xyz}"/><geometry>{geometry}</geometry></collision>'


def _box(x: float, y: float, z: float) -> str:
    return f'<box size="{x} {y} {z}"/>'


def block_urdf(colour: str) -> str:
    """A free cube of 4 cm and 10 g."""
    box = _box(BLOCK_SIZE, BLOCK_SIZE, BLOCK_SIZE)
    return _robot("block", _link("body", BLOCK_MASS, _visual(box, colour) + _collision(box), _CONTACT))


def zone_urdf(colour: str) -> str:
    """A square frame that marks a target; it collides with nothing."""
    offset = (ZONE_SIZE - ZONE_WALL) / 2
    inner = ZONE_SIZE - 2 * ZONE_WALL
    bars = [
        (offset, 0, ZONE_WALL, ZONE_SIZE),
        (-offset, 0, ZONE_WALL, ZONE_SIZE),
        (0, offset, inner, ZONE_WALL),
        (0, -offset, inner, ZONE_WALL),
    ]
    body = "".join(_visual(_box(w, d, ZONE_HEIGHT), colour, f"{x} {y} {ZONE_HEIGHT / 2}") for x, y, w, d in bars)
    return _robot("zone", _link("body", 0, body))


def workspace_urdf() -> str:
    """The grey work surface; it collides with nothing (the ground does)."""
    return _robot("workspace", _link("body", 0, _visual(_box(0.5, 1.0, 0.001), DARK_GREY, "0 0 -0.0005")))


def shaft_obj() -> str:
    """The tool's shaft: a closed prism of 64 sides along z, from z = 0.

    A prism and not URDF's <cylinder>: PyBullet rolls an exact cylinder along a block differently, and scripted
    episodes come out about four steps shorter than with the published mesh, which has 64 sides.
    """
    corners = [
        (SHAFT_RADIUS * math.cos(2 * math.pi * i / SHAFT_SIDES), SHAFT_RADIUS * math.sin(2 * math.pi * i / SHAFT_SIDES))
        for i in range(SHAFT_SIDES)
    ]
    lines = [f"v {x:.9f} {y:.9f} {z}" for z in (0, SHAFT_LENGTH) for x, y in corners]
    bottom, top = range(1, SHAFT_SIDES + 1), range(SHAFT_SIDES + 1, 2 * SHAFT_SIDES + 1)
    for i in range(SHAFT_SIDES):
        j = (i + 1) % SHAFT_SIDES
        lines += [f"f {bottom[i]} {bottom[j]} {top[j]}", f"f {bottom[i]} {top[j]} {top[i]}"]
        if 0 < i < SHAFT_SIDES - 1:
            lines += [f"f {bottom[0]} {bottom[j]} {bottom[i]}", f"f {top[0]} {top[i]} {top[j]}"]
    return "\n".join(lines) + "\n"


def tool_urdf() -> str:
    """The pushing tool: shaft and a thin needle below it, its z axis pointing down when mounted."""
    shaft = '<mesh filename="shaft.obj"/>'
    needle = f'<cylinder radius="{NEEDLE_RADIUS}" length="{NEEDLE_LENGTH}"/>'
    return _robot(
        "tool",
        _link("shaft", 0.1, _visual(shaft, DARK_GREY) + _collision(shaft), _CONTACT)
        + _link("needle", 0.1, _visual(needle, BLUE) + _collision(needle), _CONTACT)
        + '<joint name="mount" type="fixed"><parent link="shaft"/><child link="needle"/>'
        + f'<origin xyz="0 0 {NEEDLE_OFFSET}"/></joint>',
    )


def write_assets(folder: Path) -> None:
    """Write every file of the scene into `folder`."""
    files = {
        "block1.urdf": block_urdf(RED),
        "block2.urdf": block_urdf(GREEN),
        # In the published scene block 1 is red and target 1 green; no reward looks at colours.
        "zone1.urdf": zone_urdf(GREEN),
        "zone2.urdf": zone_urdf(RED),
        "workspace.urdf": workspace_urdf(),
        "shaft.obj": shaft_obj(),
        "tool.urdf": tool_urdf(),
    }
    for name, text in files.items():
        (folder / name).write_text(text)
