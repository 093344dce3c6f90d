"""The virtual rig over a tilted and bowed wafer: the dies of the virtual wafer at every place, lifted by a form."""

from __future__ import annotations

import math

import numpy as np

from wafer_viewer.model.acquisition.rig_limits import RigLimits
from wafer_viewer.rigs.virtual.camera import FrameRenderer, Sensor
from wafer_viewer.rigs.virtual.optics.optics import Optics
from wafer_viewer.rigs.virtual.rig import NUMERICAL_APERTURE, WAVELENGTH_UM, VirtualRig
from wafer_viewer.rigs.virtual.scenes.catalogue import SCENES

LATTICE_UM = 2500.0
"""The scene begins anew at every point of a lattice: its wafer is 6 mm across."""
NEAREST_UM, FARTHEST_UM = -60.0, 90.0
"""Range of z over the form that is rendered; beyond it the frames are those of its ends, as blurred as can be."""


class BowedWafer:
    """Renderer of a wafer with a form: `bow_um` over `radius_um`, tilt and a few um of waves, another for every seed.

    Within a field the form is that of its centre; the scene has a tilt of its own, 1.4 mrad.
    """

    def __init__(
        self,
        limits: RigLimits,
        seed: int,
        bow_um: float = 200.0,
        tilt_rad: float = 2e-3,
        radius_um: float = 100_000.0,
        scene: str = "wafer",
    ) -> None:
        rng = np.random.default_rng(seed)
        way = rng.uniform(0, 2 * math.pi)
        self._tilt = tilt_rad * math.cos(way), tilt_rad * math.sin(way)
        self._bow, self._radius_um = bow_um * rng.choice([-1, 1]), radius_um
        self._waves = [(rng.normal(0, 3), *rng.normal(0, 2 / radius_um, 2), rng.uniform(0, 6)) for _ in range(4)]
        self._shift = rng.uniform(-1000, 1000, 2)
        self._scene = SCENES[scene]
        optics = Optics(na=NUMERICAL_APERTURE, wavelength_um=WAVELENGTH_UM, pixel_um=limits.pixel_um)
        self._renderer = FrameRenderer(self._scene, optics, Sensor(rows=limits.camera.rows, cols=limits.camera.cols))
        self._renderer._z_range_um = NEAREST_UM, FARTHEST_UM

    def form_um(self, x_um: float, y_um: float) -> float:
        """The height of the form."""
        z_um = self._tilt[0] * x_um + self._tilt[1] * y_um
        z_um -= self._bow * (x_um**2 + y_um**2) / self._radius_um**2
        return z_um + sum(a * math.sin(kx * x_um + ky * y_um + phase) for a, kx, ky, phase in self._waves)

    def frame(self, x_um, y_um, z_um, exposure_us, seed):
        """What Renderer asks for."""
        u_um, v_um = self._in_scene(x_um, y_um)
        over_um = min(max(z_um - self.form_um(x_um, y_um), NEAREST_UM), FARTHEST_UM)
        return self._renderer.frame(u_um, v_um, over_um, exposure_us, seed)

    def truth_um(self, center_um: tuple[float, float], x_um, y_um):
        """True heights at points of the field with a centre."""
        u_um, v_um = self._in_scene(*center_um)
        off = u_um - center_um[0], v_um - center_um[1]
        return self._scene.truth(x_um + off[0], y_um + off[1]) + self.form_um(*center_um)

    def _in_scene(self, x_um: float, y_um: float) -> tuple[float, float]:
        at = x_um - LATTICE_UM * round(x_um / LATTICE_UM), y_um - LATTICE_UM * round(y_um / LATTICE_UM)
        return float(at[0] + self._shift[0]), float(at[1] + self._shift[1])


def bowed_rig(limits: RigLimits, seed: int, **form) -> tuple[VirtualRig, BowedWafer]:
    """A virtual rig with such a wafer on it."""
    wafer = BowedWafer(limits, seed, **form)
    return VirtualRig(limits=limits, renderer=wafer, seed=seed), wafer
