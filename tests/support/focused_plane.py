"""A rig whose frames are sharp at the height of a form and quickly drawn: for tests of what follows the focus."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from wafer_viewer.rigs.virtual.rig import VirtualRig, virtual_limits

ROWS, COLS, WIDTH_UM = 96, 144, 7.0
_TEXTURE = np.random.default_rng(5).normal(0, 1, (ROWS, COLS))
_NOISE = np.random.default_rng(6).normal(0, 3, (16, ROWS, COLS))


class FocusedPlane:
    """Renderer: texture whose contrast falls with the distance from form_um(x, y), the same all over a field.

    blank: says where there is nothing to focus on.
    """

    def __init__(
        self, form_um: Callable[[float, float], float], blank: Callable[[float, float], bool] = lambda x, y: False
    ) -> None:
        self._form_um, self._blank = form_um, blank

    def frame(self, x_um, y_um, z_um, exposure_us, seed):
        """What Renderer asks for."""
        off = (z_um - self._form_um(x_um, y_um)) / WIDTH_UM
        contrast = 0.0 if self._blank(x_um, y_um) else 25 / (1 + off**2) ** 2
        return np.clip(110 + contrast * _TEXTURE + _NOISE[seed % 16], 0, 255).astype(np.uint8)


def focused_rig(form_um, **settings) -> VirtualRig:
    """A virtual rig with such frames."""
    return VirtualRig(limits=virtual_limits(ROWS, COLS), renderer=FocusedPlane(form_um, **settings))


class Quiet:
    """Fulfils ProcedureControl; stops after so many steps."""

    def __init__(self, stop_after: int | None = None) -> None:
        self.steps, self.stop_after = [], stop_after

    def should_stop(self):
        return self.stop_after is not None and len(self.steps) >= self.stop_after

    def report(self, step):
        self.steps.append(step)
