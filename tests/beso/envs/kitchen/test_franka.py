"""gymnasium-robotics' own kitchen, acted in by a policy of this project."""

import contextlib
import io

import gymnasium
import numpy as np
import pytest
import torch

from beso.core.checkpoint import LoadedModel
from beso.data.scaling import Scaling
from beso.envs.kitchen import franka
from beso.envs.kitchen.simulator import KitchenEnv
from beso.envs.kitchen.spec import KETTLE, MICROWAVE, SPEC, TASKS
from beso.errors import UserError
from beso.methods import gcbc
from beso.policy import Policy


@pytest.fixture(scope="module")
def kitchen():
    with contextlib.redirect_stderr(io.StringIO()):  # it announces changes to environments that are not used here
        import gymnasium_robotics

        gymnasium.register_envs(gymnasium_robotics)
        kitchen = gymnasium.make(
            "FrankaKitchen-v1",
            tasks_to_complete=["microwave", "kettle"],
            robot_noise_ratio=0.0,
            object_noise_ratio=0.0,
        )
    yield kitchen
    kitchen.close()


@pytest.fixture(scope="module")
def policy():
    method = gcbc.Method(gcbc.Config(8, 1, 0.0), None, SPEC.sizes, torch.Generator().manual_seed(0)).eval()
    n, a = SPEC.observation_size, SPEC.action_size
    scaling = Scaling(SPEC.visible, SPEC.goal_masked, (0.0,) * n, (1.0,) * n, (-1.0,) * a, (1.0,) * a, n)
    return Policy(LoadedModel(method, scaling, 1, SPEC.goal_window), torch.device("cpu"))


def test_a_policy_acts_in_it(kitchen, policy):
    told, _ = kitchen.reset(seed=0)
    policy.reset(franka.goal(told))
    for _ in range(5):
        state = franka.observation(told)
        assert np.array_equal(state, kitchen.unwrapped.data.qpos), "30 coordinates, without noise"
        told, *_ = kitchen.step(policy.act(state))


def test_its_observations_are_those_of_play_and_evaluation_but_for_noise(kitchen):
    told, _ = kitchen.reset(seed=0)
    ours = KitchenEnv()
    observation, _ = ours.reset(seed=0)
    assert np.abs(franka.observation(told) - observation).max() < 0.03
    action = np.full(9, 0.5)
    told, *_ = kitchen.step(action)
    observation, *_ = ours.step(action)
    ours.close()
    assert np.abs(franka.observation(told) - observation).max() < 0.06


def test_a_goal_is_the_state_with_the_wanted_tasks_done(kitchen):
    told, _ = kitchen.reset(seed=0)
    goal = franka.goal(told)
    wanted = [index for task in (MICROWAVE, KETTLE) for index in TASKS[task].element]
    assert goal.shape == (2, 30)
    assert goal[:, wanted].tolist() == 2 * [[*TASKS[MICROWAVE].goal, *TASKS[KETTLE].goal]]
    others = [i for i in range(30) if i not in wanted]
    assert np.array_equal(goal[0, others], franka.observation(told)[others])


@pytest.mark.parametrize(
    ("told", "message"),
    [
        (np.zeros(59), "a dictionary with observation"),
        ({"observation": np.zeros(59)}, "a dictionary with desired_goal"),
        ({"observation": np.zeros(60), "desired_goal": {}}, r"has shape \(60,\), expected \(59,\)"),
        ({"observation": np.full(59, np.nan), "desired_goal": {}}, "must be finite"),
        ({"observation": np.zeros(59), "desired_goal": {}}, "desired_goal must map some of microwave, "),
        ({"observation": np.zeros(59), "desired_goal": {"moon": [1]}}, "desired_goal must map some of microwave, "),
        (
            {"observation": np.zeros(59), "desired_goal": {"kettle": [1]}},
            r"of kettle has shape \(1,\), expected \(7,\)",
        ),
    ],
)
def test_anything_else_is_one_line(told, message):
    with pytest.raises(UserError, match=message) as caught:
        franka.goal(told)
    assert len(str(caught.value).splitlines()) == 1
