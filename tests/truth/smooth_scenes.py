"""Focus stacks of smooth surfaces with known shape, drawn by seed: planes, steps, roofs, caps, bumps and waves.

Every pixel shows the texture blurred by the lens's transfer (`phase`) at its own distance from focus. No walls hide or
bleed: what is judged is the uncertainty of measurements, not the gates along edges. Seeds below 1000 are for tuning.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.fft import irfft2, rfft2

from tests.truth.phase import TRANSFERS, WAVELENGTH_UM, Floats
from tests.truth.shapes import texture
from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.acquisition.plan import Field

BEYOND_DOF = 3.0
"""The sweep beyond the sample, on both sides."""
UNIT_DOF = 0.08
"""Distance of the blurred pictures between which a pixel is interpolated."""
READ_NOISE, GREY = 0.002, 0.45
"""Read noise (half a grey value of 255) and mean light, as shares of white."""


Lens = Literal["waves", "rays"]


@dataclass(frozen=True)
class Optics:
    """Lens, sweep, texture, noise and faults of a stack.

    step_dof: distance of frames in depths of field; contrast: standard deviation of the reflectance; full_well_e:
    electrons at white; jitter_dof: standard deviation of a frame's z in depths of field; flicker: of its light; lens:
    whose transfer blurs (`phase`).
    """

    na: float
    step_dof: float
    contrast: float
    full_well_e: float
    jitter_dof: float = 0.0
    flicker: float = 0.0
    lens: Lens = "waves"

    @property
    def depth_of_field_um(self) -> float:
        return WAVELENGTH_UM / self.na**2

    @property
    def step_um(self) -> float:
        return self.step_dof * self.depth_of_field_um


def drawn_optics(rng: np.random.Generator) -> Optics:
    """NA .14 to .45, steps of .2 to .9 depths of field, contrast 4 to 25 %, 6 to 40 ke; a fifth jitters, a fifth
    flickers."""
    na, contrast, full_well_e = (
        float(np.exp(rng.uniform(np.log(low), np.log(high)))) for low, high in ((0.14, 0.45), (0.04, 0.25), (6e3, 4e4))
    )
    jitter_dof, flicker = float(rng.uniform(0.01, 0.05)), float(rng.uniform(0.01, 0.05))
    jitters, flickers = rng.random(2) < 0.2
    step_dof = float(rng.uniform(0.2, 0.9))
    return Optics(na, step_dof, contrast, full_well_e, jitter_dof if jitters else 0.0, flicker if flickers else 0.0)


def stack_of(z_um: Floats, optics: Optics, rng: np.random.Generator, pixel_um: float) -> FieldStack:
    """The focus stack of a surface."""
    depth_um = optics.depth_of_field_um
    step_um = optics.step_dof * depth_um
    low_um, high_um = float(z_um.min()) - BEYOND_DOF * depth_um, float(z_um.max()) + BEYOND_DOF * depth_um
    frames_um = low_um + rng.uniform(0, step_um) + step_um * np.arange(int((high_um - low_um) / step_um))
    true_um = frames_um + optics.jitter_dof * depth_um * rng.standard_normal(len(frames_um))
    gains = 1 + optics.flicker * rng.standard_normal(len(frames_um))
    unit_um = UNIT_DOF * depth_um
    last = int(np.ceil((high_um - low_um) / unit_um)) + 2
    sharp = rfft2(texture(z_um.shape, rng) * optics.contrast)
    transfer = TRANSFERS[optics.lens](z_um.shape, optics.na, pixel_um)
    blurred = np.stack([irfft2(sharp * transfer.at(n * unit_um), z_um.shape) for n in range(last)]).astype(np.float32)
    images = np.empty((len(frames_um), *z_um.shape), np.uint8)
    for k, (z, gain) in enumerate(zip(true_um, gains, strict=True)):
        off = np.minimum(np.abs(z - z_um) / unit_um, last - 1.001)
        whole = off.astype(np.intp)
        near, far = (np.take_along_axis(blurred, n[None], axis=0)[0] for n in (whole, whole + 1))
        light = np.clip(gain * GREY * (1 + near + (off - whole) * (far - near)), 0, None)
        seen = light + np.sqrt(light / optics.full_well_e + (READ_NOISE) ** 2) * rng.standard_normal(z_um.shape)
        images[k] = np.clip(np.rint(255 * seen), 0, 255)
    field = Field(number=1, row=0, col=0, x_um=0.0, y_um=0.0, z_start_um=float(frames_um[0]))
    known_um = depth_um + pixel_um / optics.na
    present = np.ones(len(frames_um), bool)
    return FieldStack(field, images, frames_um, present, pixel_um, simulated=True, depth_of_field_um=known_um)
