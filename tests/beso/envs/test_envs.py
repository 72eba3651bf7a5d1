import importlib
import os
import subprocess
import sys

import gymnasium
import numpy as np
import pytest

from beso import envs
from beso.errors import UserError


@pytest.mark.parametrize("error", [RuntimeError("no such library\nmore"), ImportError()])
def test_an_environment_whose_packages_refuse_to_load_is_one_line(monkeypatch, error):
    def refuse(name):
        raise error

    name = envs.names()[0]
    monkeypatch.setattr(importlib, "import_module", refuse)
    with pytest.raises(UserError, match=f"environment '{name}' cannot be loaded: ") as caught:
        envs.evaluation(name)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize("settings", [{"MUJOCO_GL": "elg"}, {"MUJOCO_GL": "egl", "PYOPENGL_PLATFORM": "osmesa"}])
def test_wrong_opengl_settings_stop_nothing_that_does_not_draw(settings):
    code = """
import os
from beso import envs
from beso.errors import CannotDrawError
envs.recorder("kitchen")
environment = envs.evaluation("kitchen").make(render_mode="rgb_array")
environment.reset(seed=0)
environment.step(environment.action_space.sample())
try:
    environment.render()
except CannotDrawError as error:
    assert len(str(error).splitlines()) == 1
print(os.environ["MUJOCO_GL"])
"""
    done = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, **settings}, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split()[-1] == settings["MUJOCO_GL"], "as it was"


def test_importing_them_imports_neither_torch_nor_a_simulator():
    code = """
import sys, gymnasium, beso.envs
heavy = {"torch", "mujoco", "gymnasium_robotics", "pybullet", "cv2"}
assert not heavy & sys.modules.keys(), heavy & sys.modules.keys()
assert {beso.envs.gymnasium_name(name) for name in beso.envs.names()} <= gymnasium.registry.keys()
sys.modules["gymnasium"] = None
del sys.modules["beso.envs"]
import beso.envs
"""
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", envs.names())
def test_gymnasium_makes_each_with_a_goal_and_numbers_in_its_spaces(name):
    env = gymnasium.make(envs.gymnasium_name(name), max_episode_steps=3)
    spec = envs.spec(name)
    observation, info = env.reset(seed=0)
    assert info["goal"].shape == (spec.goal_window, *env.observation_space.shape)
    assert (env.action_space.shape, env.action_space.dtype) == ((spec.action_size,), np.float32)
    for space in (env.observation_space, env.action_space):
        assert space.is_bounded()
    for _ in range(3):
        assert env.observation_space.contains(observation)
        observation, _, _, truncated, _ = env.step(env.action_space.sample())
    assert truncated
    env.close()


@pytest.mark.parametrize("name", envs.names())
def test_the_interface_tells_of_every_number(name):
    interface, spec = envs.interface(name), envs.spec(name)
    assert sum(part.width for part in interface.observation) == spec.observation_size
    assert sum(part.width for part in interface.action) == spec.action_size
    assert interface.period > 0
