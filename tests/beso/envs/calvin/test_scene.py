"""The scene: CALVIN's names, frames, axes, limits and forces."""

import time

import numpy as np
import pytest

from beso.envs.calvin.simulator.arm import NEUTRAL_JOINTS
from beso.envs.calvin.simulator.assets import official_assets, write_assets
from beso.envs.calvin.simulator.observations import (
    ARM_JOINTS,
    BUTTON,
    DRAWER,
    LED,
    LIGHTBULB,
    SLIDE,
    SWITCH,
    TCP_EULER,
    TCP_POSITION,
    block_slice,
)
from beso.envs.calvin.simulator.play_table import PlayTable
from beso.envs.calvin.simulator.table import BLOCK_SIZES
from beso.errors import UserError

STAY = np.array([0, 0, 0, 0, 0, 0, 1.0])


def joints(table, body):
    infos = [table._client.getJointInfo(body, i) for i in range(table._client.getNumJoints(body))]
    return {info[1].decode(): info for info in infos}


def push_joint(table, joint, force, actions):
    """Push a link of the table along the direction in which its joint grows, newtons, while the arm stands still."""
    index = joints(table, table.fixtures.body)[joint][0]
    direction = {"base__slide": (-1, 0, 0), "base__drawer": (0, -1, 0), "base__button": (0, 0, -1)}[joint]
    client = table._client
    for _ in range(8 * actions):
        place = client.getLinkState(table.fixtures.body, index)[0]
        client.applyExternalForce(
            table.fixtures.body, index, np.multiply(direction, force).tolist(), place, client.WORLD_FRAME
        )
        client.stepSimulation()


def test_joints_have_calvins_names_and_limits(table):
    found = joints(table, table.fixtures.body)
    prismatic = {name: info[8:10] for name, info in found.items() if info[2] == table._client.JOINT_PRISMATIC}
    assert prismatic == {
        "base__slide": pytest.approx((0, 0.28)),
        "base__drawer": pytest.approx((0, 0.22)),
        "base__button": pytest.approx((0, 0.02)),
        "base__switch": pytest.approx((0, 0.088)),
    }
    assert set(found) - set(prismatic) == {"base__led", "base__light", "base__plank"}
    assert set(table.fixtures.links.values()) == {
        "base_link", "slide_link", "drawer_link", "button_link", "switch_link", "led_link", "light_link", "plank_link",
    }  # fmt: skip


def test_arm_has_calvins_link_numbers(table):
    links = {name: info[0] for name, info in joints(table, table.arm.body).items()}
    expected = {"panda_joint1": 0, "panda_joint7": 6, "panda_finger_joint1": 9, "panda_finger_joint2": 11}
    expected |= {"joint_finger_tip_left": 10, "joint_finger_tip_right": 12, "camera_joint": 14, "tcp_joint": 15}
    assert {name: links[name] for name in expected} == expected


@pytest.mark.parametrize(
    ("joint", "entry", "amount", "direction"),
    [
        ("base__slide", SLIDE, 0.2, (-1, 0, 0)),
        ("base__drawer", DRAWER, 0.2, (0, -1, 0)),
        ("base__button", BUTTON, 0.01, (0, 0, -1)),
        ("base__switch", SWITCH, 0.08, (0, 0.5, np.sqrt(0.75))),
    ],
)
def test_joints_move_along_calvins_axes(table, scene, joint, entry, amount, direction):
    index = joints(table, table.fixtures.body)[joint][0]

    def place(position):
        scene[entry] = position
        table.reset(scene)
        return np.array(table._client.getLinkState(table.fixtures.body, index)[4])

    start = place(0.0)
    # The button's spring has acted for one step of physics.
    assert place(amount) - start == pytest.approx(amount * np.array(direction), abs=1e-3)


def test_neutral_pose_is_calvins(table, scene):
    table.reset(scene)
    robot_obs = table.robot_obs()
    assert robot_obs[TCP_POSITION] == pytest.approx([0.0259, -0.2313, 0.5713], abs=1e-4)
    assert robot_obs[TCP_EULER] == pytest.approx([3.0905, -0.0291, 1.5001], abs=1e-4)
    assert robot_obs[6] == pytest.approx(0.08, abs=1e-5)
    assert robot_obs[ARM_JOINTS] == pytest.approx(NEUTRAL_JOINTS, abs=1e-5)


def test_blocks_have_calvins_sizes_and_rest_on_the_table(table, scene):
    table.reset(scene)
    for body, name in zip(table._blocks, ("block_red", "block_blue", "block_pink"), strict=True):
        dimensions = table._client.getCollisionShapeData(body, -1)[0][3]
        assert dimensions == pytest.approx(BLOCK_SIZES[name])
        dynamics = table._client.getDynamicsInfo(body, -1)
        assert (dynamics[0], dynamics[1], dynamics[7]) == pytest.approx((1.0, 0.7, 0.001))
    for _ in range(15):
        table.step(STAY)
    assert [table.scene_obs()[block_slice(b)][2] for b in range(3)] == pytest.approx([0.46] * 3, abs=1e-3)
    assert all(block.touched_links == {"base_link"} for block in table.state().blocks.values())


def test_a_block_in_the_cabinet_touches_the_plank_alone(table, scene):
    scene[block_slice(0)] = -0.24, 0.085, 0.461, 0, 0, np.pi / 2
    table.reset(scene)
    table.step(STAY)
    assert table.state().blocks["block_red"].touched_links == {"plank_link"}


@pytest.mark.parametrize(("joint", "entry"), [("base__slide", SLIDE), ("base__drawer", DRAWER)])
def test_brakes_hold_against_less_than_four_newtons(table, scene, joint, entry):
    scene[entry] = 0.1
    table.reset(scene)
    push_joint(table, joint, 3.0, actions=15)
    assert table.scene_obs()[entry] == pytest.approx(0.1, abs=1e-3)
    push_joint(table, joint, 6.0, actions=15)
    assert table.scene_obs()[entry] > 0.15


def test_button_springs_back(table, scene):
    scene[BUTTON] = 0.02
    table.reset(scene)
    for _ in range(10):
        table.step(STAY)
    assert table.scene_obs()[BUTTON] == pytest.approx(0.0, abs=2e-3)


def test_led_toggles_each_time_the_button_goes_down(table, scene):
    table.reset(scene)
    seen = []
    for _ in range(3):
        for force in (10.0, 0.0):
            push_joint(table, "base__button", force, actions=4)
            table.fixtures.update_lights()
            seen.append(table.scene_obs()[LED])
    assert seen == [1, 1, 0, 0, 1, 1]


def test_a_button_that_starts_pressed_does_not_toggle(table, scene):
    scene[BUTTON] = 0.02
    table.reset(scene)
    for _ in range(10):
        table.step(STAY)
    assert table.scene_obs()[LED] == 0


def test_lightbulb_follows_the_switchs_position(table, scene):
    table.reset(scene)
    index = joints(table, table.fixtures.body)["base__switch"][0]
    seen = []
    for position in (0.03, 0.05, 0.08, 0.05, 0.03):
        table._client.resetJointState(table.fixtures.body, index, position)
        table.fixtures.update_lights()
        seen.append(table.scene_obs()[LIGHTBULB])
    assert seen == [0, 1, 1, 1, 0]


def test_a_lightbulb_that_disagrees_with_its_switch_waits_for_the_next_crossing(table, scene):
    scene[SWITCH], scene[LIGHTBULB] = 0.088, 0
    table.reset(scene)
    table.step(STAY)
    assert table.scene_obs()[LIGHTBULB] == 0


@pytest.mark.parametrize(
    ("entries", "channels"), [({LED: 1}, "green"), ({SWITCH: 0.088, LIGHTBULB: 1}, "yellow"), ({DRAWER: 0.2}, None)]
)
def test_pictures_show_the_state(table, scene, entries, channels):
    table.reset(scene)
    before = table.picture(112).astype(int)
    for entry, value in entries.items():
        scene[entry] = value
    table.reset(scene)
    after = table.picture(112).astype(int)
    assert (np.abs(after - before).max(axis=2) > 30).sum() > 15
    lit = (after[..., 1] > 150) & (after[..., 2] < 60)
    if channels == "green":
        assert (lit & (after[..., 0] < 60)).any()
    if channels == "yellow":
        assert (lit & (after[..., 0] > 150)).any()


def test_pictures_show_the_three_blocks(table, scene):
    table.reset(scene)
    r, g, b = np.moveaxis(table.picture(112).astype(int), 2, 0)
    assert ((r > 120) & (g < 30) & (b < 30)).sum() > 10
    assert ((r < 30) & (g < 30) & (b > 120)).sum() > 10
    assert ((r > 120) & (g < 30) & (b > 120)).sum() > 10


def test_time_of_a_picture(table, scene, capsys):
    table.reset(scene)
    table.picture(112)
    start = time.process_time()
    for _ in range(20):
        table.picture(112)
    with capsys.disabled():
        print(f"\n{(time.process_time() - start) / 20 * 1e3:.1f} ms of one core for a picture of 112 pixels")


def test_other_files_are_loaded_from_calvins_folder(tmp_path, table, scene):
    ours = tmp_path / "ours"
    ours.mkdir()
    files = write_assets(ours)
    data = tmp_path / "data"
    names = ("red_middle", "blue_small", "pink_big")
    places = {
        files.panda: "franka_panda/panda_longer_finger.urdf",
        files.table: "calvin_table_D/urdf/calvin_table_D.urdf",
    }
    places |= {path: f"blocks/block_{name}.urdf" for path, name in zip(files.blocks, names, strict=True)}
    for path, place in places.items():
        (data / place).parent.mkdir(parents=True, exist_ok=True)
        (data / place).write_bytes(path.read_bytes())
    other = PlayTable(data)
    for each in (table, other):
        each.reset(scene)
        each.step(STAY)
    assert other.scene_obs().tobytes() == table.scene_obs().tobytes()
    other.close()
    (data / "blocks" / "block_pink_big.urdf").unlink()
    with pytest.raises(UserError, match=r"block_pink_big.urdf is missing; the folder must be `data`"):
        official_assets(data)
