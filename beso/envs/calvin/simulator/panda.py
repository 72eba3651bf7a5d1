"""The Panda arm of pybullet_data, changed into CALVIN's: longer finger tips and a tool centre point.

The detailed meshes that one usually sees are replaced by those for collisions: the detailed ones alone would take
18 ms of each picture, at any resolution. The camera's link carries no camera; it is there so that links have the
numbers that they have in CALVIN (arm 0-6, fingers 9 and 11, tips 10 and 12, tcp 15).
"""

import re
from pathlib import Path

import pybullet_data

from beso.envs.calvin.simulator.urdf import Vector

TIP_SIZE = (0.02, 0.012, 0.045)  # metres; fingers this much longer reach past a block's upper edge
TIP_OFFSET, TIP_HEIGHT = 0.0065, 0.067
TCP_DISTANCE = 0.14  # m, from the hand's frame to between the tips


def panda_urdf() -> str:
    """The arm's URDF, with absolute paths to the meshes of pybullet_data; lengths are not scaled."""
    folder = Path(pybullet_data.getDataPath()) / "franka_panda"
    text = (folder / "panda.urdf").read_text()
    text = re.sub(r"package://meshes/visual/(link[1-6]|hand|finger)\.obj", r"package://meshes/collision/\1.obj", text)
    text = text.replace("package://meshes/", f"{folder.as_posix()}/meshes/")
    tips = _tip("left", 1) + _tip("right", -1)
    camera = _attached("camera_joint", "gripper_cam", (-0.1, 0, 0), (1.3, 0, -1.57), 0.2)
    tcp = _attached("tcp_joint", "tcp", (0, 0, TCP_DISTANCE), (0, 0, 0), 1e-5)
    return text.replace("</robot>", f"{tips}{camera}{tcp}</robot>")


def _inertial(mass: float, inertia: float) -> str:
    moments = f'ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"'
    return f'<inertial><mass value="{mass}"/><inertia {moments}/></inertial>'


def _tip(side: str, sign: int) -> str:
    shape = '<origin xyz="0 0 0" rpy="0 0 0"/><geometry><box size="{} {} {}"/></geometry>'.format(*TIP_SIZE)
    material = '<material name="finger_tip"><color rgba="0.9 0.9 0.9 1"/></material>'
    contact = '<contact><lateral_friction value="1.0"/><spinning_friction value="0.001"/></contact>'
    return (
        f'<joint name="joint_finger_tip_{side}" type="fixed">'
        f'<origin xyz="0 {sign * TIP_OFFSET} {TIP_HEIGHT}" rpy="0 0 0"/>'
        f'<parent link="panda_{side}finger"/><child link="finger_{side}_tip"/></joint>'
        f'<link name="finger_{side}_tip">{contact}{_inertial(0.0001, 1e-6)}'
        f"<visual>{shape}{material}</visual><collision>{shape}</collision></link>"
    )


def _attached(joint: str, link: str, xyz: Vector, rpy: Vector, mass: float) -> str:
    """A link without a shape, fixed to the hand."""
    origin = '<origin xyz="{} {} {}" rpy="{} {} {}"/>'.format(*xyz, *rpy)
    return (
        f'<joint name="{joint}" type="fixed"><parent link="panda_hand"/><child link="{link}"/>{origin}</joint>'
        f'<link name="{link}">{_inertial(mass, 0.001)}</link>'
    )
