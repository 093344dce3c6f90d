"""A textured plane in small stairs through all phases between two frames, blurred by the transfer of a lens.

The transfer is that of waves (Stokseth 1969), or that of rays, which blurs more near the focus: its focus curves are
narrower at the same depth of field, and those of real lenses lie between the two. Every stair is a level plane, whose
transfer is the same above and below its focus: a focus curve is symmetric about the true height, and whatever an
estimate owes to the place of the frames is an odd function of the phase. Nothing is shared with the renderers of
`views` and `bleeding`, nor with the virtual rig.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft2, rfft2
from scipy.special import j1

from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.acquisition.plan import Field

WAVELENGTH_UM, PIXEL_UM = 0.55, 0.46729
AIRY_SIGMA = 0.21
"""Standard deviation of the Gaussian nearest to the Airy disc, in wavelengths over the aperture."""
PHASES, STAIR_PX = 16, 4
"""Stairs a step, and their width."""
WRONG_PERIODS = (0.37, 0.61, 1.39, 1.63, 2.43, 2.57)
"""Periods a step that no phase error has: what they show is sampling noise."""
HARMONICS = (1, 2, 3)
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Tilted:
    """Optics, sample and camera; step_dof: step in depths of field, wavelength / NA^2.

    contrast: standard deviation of the reflectance where it is sharp; grains: share of pixels with a mirror grain, six
    times as bright as the rest and seen by half of the aperture; jitter: largest deviation of a frame from even
    distances, in steps, known to the stack. full_well_e None: a camera without noise. lens: whose transfer blurs.
    """

    na: float = 0.28
    step_dof: float = 0.45
    contrast: float = 0.25
    full_well_e: float | None = 15_000.0
    bits: int = 8
    grains: float = 0.0
    jitter: float = 0.0
    seed: int = 1
    shape: tuple[int, int] = (96, 384)
    beyond_dof: float = 5.0
    lens: Literal["waves", "rays"] = "waves"

    @property
    def depth_of_field_um(self) -> float:
        return WAVELENGTH_UM / self.na**2

    @property
    def step_um(self) -> float:
        return self.step_dof * self.depth_of_field_um


@dataclass(frozen=True, eq=False)
class Stairs:
    """The stack of a scene, and the true height of each column in um."""

    scene: Tilted
    stack: FieldStack
    truth_um: Floats


@dataclass(frozen=True, slots=True)
class PhaseError:
    """In steps: mean square of the phase error without sampling noise, noise of a pixel, share of heights a step off.

    The mean square may be negative, so that means of several scenes are not biased.
    """

    power: float
    noise: float
    false_share: float

    @property
    def rms(self) -> float:
        return float(np.sqrt(max(0.0, self.power)))


def stairs(scene: Tilted) -> Stairs:
    """The focus stack of a scene."""
    rng = np.random.default_rng(scene.seed)
    heights = np.arange(scene.shape[1]) // STAIR_PX / PHASES
    heights_um = (heights - heights[-1] / 2) * scene.step_um
    away = int(np.ceil(scene.beyond_dof / scene.step_dof + heights[-1] / 2))
    z_um = np.arange(-away, away + 1.0) * scene.step_um
    z_um += rng.uniform(-1, 1, len(z_um)) * scene.jitter * scene.step_um
    texture = rng.standard_normal(scene.shape)
    diffuse = rfft2(_unit(texture) * scene.contrast)
    mirrors = rfft2(6.0 * (rng.random(scene.shape) < scene.grains))
    white = (2**scene.bits) - 1
    images = np.empty((len(z_um), *scene.shape), np.uint8 if scene.bits == 8 else np.uint16)
    level, column = np.unique(heights_um, return_inverse=True)
    transfer, half = (TRANSFERS[scene.lens](scene.shape, na) for na in (scene.na, scene.na / 2))
    unit_um = scene.step_um / PHASES / (8 if scene.jitter else 1)
    blurred: dict[int, Floats] = {}
    for k, z in enumerate(z_um):
        light = np.empty(scene.shape)
        for n, at_um in enumerate(level):
            off = round(abs(z - at_um) / unit_um)
            if off not in blurred:
                spread = diffuse * transfer.at(off * unit_um)
                blurred[off] = irfft2(spread + mirrors * half.at(off * unit_um), scene.shape)
            light[:, column == n] = blurred[off][:, column == n]
        share = 0.4 * (1 + light)
        if scene.full_well_e is not None:
            variance = np.clip(share, 0, None) / scene.full_well_e + (0.4 / 255) ** 2
            share = share + np.sqrt(variance) * rng.standard_normal(scene.shape)
        images[k] = np.clip(np.rint(share * white), 0, white)
    field = Field(number=1, row=0, col=0, x_um=0.0, y_um=0.0, z_start_um=0.0)
    present = np.ones(len(z_um), bool)
    depth_um = scene.depth_of_field_um + PIXEL_UM / scene.na
    stack = FieldStack(field, images, z_um, present, PIXEL_UM, depth_of_field_um=depth_um)
    return Stairs(scene, stack, heights_um)


def errors_of(seen: Stairs, z_um: NDArray[np.floating], margin_px: int = 16) -> tuple[Floats, Floats]:
    """(errors of heights [row, col], their phases), both in steps, flat, the border aside."""
    inner = slice(margin_px, -margin_px)
    error = (z_um - seen.truth_um)[inner, inner] / seen.scene.step_um
    return error.ravel(), np.broadcast_to(seen.truth_um[inner] / seen.scene.step_um, error.shape).ravel()


def phase_error(error: Floats, phase: Floats) -> PhaseError:
    """The phase error: sine harmonics of the error, less what wrong periods have."""
    right = np.abs(error) < 1
    near, at = error[right] - error[right].mean(), 2 * np.pi * phase[right]
    power = {n: 2 * np.mean(near * np.sin(n * at)) ** 2 for n in (*HARMONICS, *WRONG_PERIODS)}
    noise = np.mean([power[n] for n in WRONG_PERIODS])
    found = sum(power[n] - noise for n in HARMONICS)
    return PhaseError(float(found), float(near.std()), float(1 - right.mean()))


def pooled(found: Sequence[PhaseError]) -> PhaseError:
    """The mean of several scenes."""
    return PhaseError(*(float(np.mean([getattr(one, name) for one in found])) for name in PhaseError.__slots__))


class Transfer:
    """Stokseth's approximation of the transfer of a lens out of focus, and the area of a pixel."""

    def __init__(self, shape: tuple[int, int], na: float, pixel_um: float = PIXEL_UM) -> None:
        rows, cols = np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])[None, :]
        frequency = np.hypot(rows, cols) / pixel_um
        s = np.minimum(frequency * WAVELENGTH_UM / na, 2.0)
        self._focused = (1 - 0.69 * s + 0.0076 * s**2 + 0.043 * s**3) * (s < 2) * np.sinc(rows) * np.sinc(cols)
        self._per_um, self._place = _different(4 * np.pi / WAVELENGTH_UM * (1 - np.sqrt(1 - na**2)) * s * (1 - s / 2))

    def at(self, defocus_um: float) -> Floats:
        x = np.maximum(np.abs(self._per_um * defocus_um), 1e-9)
        return self._focused * 2 * j1(x)[self._place] / x[self._place]


class RayTransfer:
    """Disc of the rays out of focus, blurred by the Gaussian nearest to the Airy disc, and the area of a pixel."""

    def __init__(self, shape: tuple[int, int], na: float, pixel_um: float = PIXEL_UM) -> None:
        rows, cols = np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])[None, :]
        frequency = np.hypot(rows, cols) / pixel_um
        self._frequency, self._place = _different(frequency)
        diffraction = np.exp(-2 * (np.pi * AIRY_SIGMA * WAVELENGTH_UM / na * frequency) ** 2)
        self._focused = diffraction * np.sinc(rows) * np.sinc(cols)
        self._tangent = na / np.sqrt(1 - na**2)

    def at(self, defocus_um: float) -> Floats:
        x = np.maximum(2 * np.pi * abs(defocus_um) * self._tangent * self._frequency, 1e-9)
        return self._focused * 2 * j1(x)[self._place] / x[self._place]


def _different(values: Floats) -> tuple[Floats, NDArray[np.intp]]:
    """The different values, and which of them each place has: a function of them is computed once for each."""
    different, place = np.unique(values, return_inverse=True)
    return different, place.reshape(values.shape)


TRANSFERS = {"waves": Transfer, "rays": RayTransfer}


def _unit(texture: Floats) -> Floats:
    return texture / texture.std()
