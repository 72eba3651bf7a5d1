"""Text of URDF files, from dimensions in world metres.

CALVIN loads its table and blocks with a global scale of 0.8, so lengths in its files are world lengths / 0.8. Ours do
the same: then the official files can stand in for ours without another change. Angles are radians, masses kilograms.
PyBullet recomputes inertia from the collision shapes, so the inertia in the files has no effect.
"""

from collections.abc import Sequence

SCALE = 0.8
Vector = Sequence[float]
NO_ROTATION = (0.0, 0.0, 0.0)

_INERTIA = '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/>'


def _lengths(*values: float) -> str:
    return " ".join(f"{value / SCALE:.6f}" for value in values)


def _plain(values: Vector) -> str:
    return " ".join(f"{value:.9g}" for value in values)


def _origin(xyz: Vector, rpy: Vector) -> str:
    return f'<origin xyz="{_lengths(*xyz)}" rpy="{_plain(rpy)}"/>'


def _shape(geometry: str, centre: Vector, rpy: Vector, colour: Vector) -> str:
    """A shape that is seen and that collides. PyBullet gives materials of one name one colour: name = colour."""
    place = f"{_origin(centre, rpy)}<geometry>{geometry}</geometry>"
    name = "colour" + "".join(f"{round(255 * value):02x}" for value in colour)
    material = f'<material name="{name}"><color rgba="{_plain((*colour, 1.0))}"/></material>'
    return f"<visual>{place}{material}</visual><collision>{place}</collision>"


def box(low: Vector, high: Vector, colour: Vector) -> str:
    """A box along the axes of its link from corner `low` to corner `high`."""
    centre = [(a + b) / 2 for a, b in zip(low, high, strict=True)]
    return turned_box(centre, [b - a for a, b in zip(low, high, strict=True)], NO_ROTATION, colour)


def turned_box(centre: Vector, size: Vector, rpy: Vector, colour: Vector) -> str:
    """A box of edges `size` about `centre`, turned by `rpy`."""
    return _shape(f'<box size="{_lengths(*size)}"/>', centre, rpy, colour)


def cylinder(radius: float, length: float, centre: Vector, rpy: Vector, colour: Vector) -> str:
    """A cylinder along the z axis turned by `rpy`."""
    return _shape(f'<cylinder radius="{_lengths(radius)}" length="{_lengths(length)}"/>', centre, rpy, colour)


def sphere(radius: float, centre: Vector, colour: Vector) -> str:
    """A ball."""
    return _shape(f'<sphere radius="{_lengths(radius)}"/>', centre, NO_ROTATION, colour)


def link(name: str, mass: float, shapes: str, contact: str = "") -> str:
    """A rigid body; a mass of 0 makes the root of a tree immovable."""
    return f'<link name="{name}">{contact}<inertial><mass value="{mass}"/>{_INERTIA}</inertial>{shapes}</link>'


def fixed(name: str, child: str, xyz: Vector, rpy: Vector) -> str:
    """A joint that holds `child` in base_link."""
    return (
        f'<joint name="{name}" type="fixed">{_origin(xyz, rpy)}'
        f'<parent link="base_link"/><child link="{child}"/></joint>'
    )


def prismatic(name: str, child: str, xyz: Vector, rpy: Vector, axis: Vector, travel: float) -> str:
    """A joint that slides `child` in base_link from 0 to `travel` along `axis`, given in the joint's frame."""
    limit = f'<limit lower="0" upper="{_lengths(travel)}" effort="0" velocity="0"/>'
    return (
        f'<joint name="{name}" type="prismatic">{_origin(xyz, rpy)}<parent link="base_link"/><child link="{child}"/>'
        f'<axis xyz="{_plain(axis)}"/>{limit}</joint>'
    )


def robot(name: str, body: str) -> str:
    """The whole file. PyBullet reads it by lines and cuts long ones, hence the line breaks."""
    body = body.replace("><", ">\n<")
    return f'<?xml version="1.0"?>\n<robot name="{name}">{body}</robot>\n'
