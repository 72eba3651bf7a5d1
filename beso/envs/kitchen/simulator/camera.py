"""Pictures of a MuJoCo scene without a window."""

import importlib
import os
from typing import Any

import mujoco
import numpy as np

from beso.errors import CannotDrawError, UserError

VIEW = {"distance": 2.2, "azimuth": 70.0, "elevation": -35.0, "lookat": (-0.2, 0.5, 2.0)}  # as FrankaKitchen-v1
SLOW_EFFECTS = (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION)  # most of the time on a CPU


class Camera:
    """A free camera on the kitchen.

    Args:
        model: the compiled scene.
        size: (height, width) of the pictures in pixels.

    Raises:
        CannotDrawError: MuJoCo cannot draw on this machine.
        UserError: the size is too large.
    """

    def __init__(self, model: mujoco.MjModel, size: tuple[int, int]) -> None:
        height, width = size
        largest = model.vis.global_.offheight, model.vis.global_.offwidth
        if not (0 < height <= largest[0] and 0 < width <= largest[1]):
            raise UserError(f"render_size {size} is not between (1, 1) and {largest} (height, width)")
        self._model = model
        self._opengl = _opengl(width, height)
        self._opengl.make_current()
        self._viewport = mujoco.MjrRect(0, 0, width, height)
        self._scene = mujoco.MjvScene(model, maxgeom=1000)
        for effect in SLOW_EFFECTS:
            self._scene.flags[effect] = False
        self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._view = mujoco.MjvCamera()
        for name, value in VIEW.items():
            setattr(self._view, name, value)

    def picture(self, data: mujoco.MjData) -> np.ndarray:
        """The scene in this state, (height, width, 3) uint8 RGB."""
        self._opengl.make_current()
        option, perturbation = mujoco.MjvOption(), mujoco.MjvPerturb()
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(self._model, data, option, perturbation, self._view, everything, self._scene)
        mujoco.mjr_render(self._viewport, self._scene, self._context)
        pixels = np.empty((self._viewport.height, self._viewport.width, 3), dtype=np.uint8)
        mujoco.mjr_readPixels(pixels, None, self._viewport, self._context)
        return pixels[::-1].copy()  # OpenGL's first row is the lowest

    def close(self) -> None:
        """Free what the graphics driver holds."""
        self._opengl.make_current()
        self._context.free()
        self._opengl.free()


def _opengl(width: int, height: int) -> Any:
    """An OpenGL context without a window: EGL, or OSMesa where MUJOCO_GL says so (a process can load only one)."""
    name = "osmesa" if os.environ.get("MUJOCO_GL", "").lower() == "osmesa" else "egl"
    try:
        return importlib.import_module(f"mujoco.{name}").GLContext(width, height)
    except Exception as error:  # no library, no device, no permission: each fails in a way of its own
        raise CannotDrawError(
            f"MuJoCo cannot draw with {name} on this machine ({type(error).__name__}): install libEGL, or install "
            "libOSMesa and set MUJOCO_GL=osmesa; only films need it"
        ) from None
