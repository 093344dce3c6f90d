"""Smooth steep relief without walls, drawn by seed: planes, waves, bumps, saddles and rough ground.

The steepest place of a relief rises by one to five frames over a focus window of 9 px, and by half the cone of light of
the objective at most. Light is traced by rays (`views`). Tuning sees seeds below 1000; figures are reported on seeds
from 1000 on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.truth.scene import PIXEL_UM
from tests.truth.scenes import MARGIN_PX, smooth_scene
from tests.truth.shapes import Array, blobs, lattice_um, turned
from tests.truth.unseen import light_at_heights
from tests.truth.views import Camera, Optics, light_of, white_light_of
from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.acquisition.plan import Field

WINDOW_PX = 9
"""Window over which slopes are told in steps."""
STEEPEST_CONE_SHARE = 0.5
MOST_FRAMES, LEAST_FRAMES = 150, 25
VIEWS = 240
RELIEFS = ("plane", "waves", "bumps", "saddle", "rough")


@dataclass(frozen=True, eq=False)
class Relief:
    """A drawn relief: its stack, its true heights in um and the grey of each pixel in focus, [row, col].

    steps_a_window: how many frames its steepest place rises over 9 px; step_dof: the step in depths of field.
    """

    seed: int
    name: str
    na: float
    step_dof: float
    steps_a_window: float
    full_well_e: float
    stack: FieldStack
    truth_um: Array
    sharp_grey: Array

    @property
    def step_um(self) -> float:
        """Distance of the frames in um."""
        return float(np.median(np.diff(self.stack.z_um)))

    @property
    def depth_um(self) -> float:
        """Depth of field in um."""
        return self.step_um / self.step_dof

    @property
    def about(self) -> str:
        """The scene in a few words."""
        return (
            f"{self.seed} {self.name}, NA {self.na:.2f}, step {self.step_dof:.2f} depths of field, "
            f"{self.steps_a_window:.1f} steps a window, {len(self.stack.z_um)} frames, {self.full_well_e / 1e3:.0f} ke"
        )


def drawn_relief(seed: int, side: int = 160, name: str | None = None) -> Relief:
    """The relief of a seed, `side` pixels wide; of a kind that is named, or that the seed gives."""
    rng = np.random.default_rng((seed, 23))
    na, step_dof = _log_uniform(rng, 0.14, 0.45), float(rng.uniform(0.2, 0.9))
    optics = Optics(na, bool(rng.random() < 0.5), VIEWS)
    depth_um = optics.wavelength_um / na**2
    step_um = step_dof * depth_um
    name = name or RELIEFS[seed % len(RELIEFS)]
    cone = np.sqrt(1 - na**2) / na
    slope = min(_log_uniform(rng, 1.0, 5.0) * step_um / (WINDOW_PX * PIXEL_UM), STEEPEST_CONE_SHARE * cone)
    height_um = _shape(name, (side, side), rng)
    inner = height_um[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX]
    steepest = np.hypot(*np.gradient(inner, PIXEL_UM)).max()
    margin_um = float(rng.uniform(1.0, 2.0)) * (2 * depth_um + 2 * step_um)
    highest = (MOST_FRAMES - 1) * step_um - 2 * margin_um
    height_um *= min(slope / steepest, highest / np.ptp(inner))
    low, high = float(inner.min()), float(inner.max())
    n_frames = int(np.clip(np.ceil((high - low + 2 * margin_um) / step_um) + 1, LEAST_FRAMES, MOST_FRAMES))
    z_um = (low + high) / 2 + step_um * (np.arange(n_frames) - (n_frames - 1) / 2 + rng.uniform(-0.5, 0.5))
    # Beyond the frame the ground goes on level where it would leave the sweep.
    scene = smooth_scene(name, seed, (side, side), np.clip(height_um, z_um[0], z_um[-1]), _log_uniform(rng, 0.1, 0.5))
    light = light_of(scene, optics, z_um)
    light /= np.float32(white_light_of(scene, light, z_um, 0.001))
    full_well_e = _log_uniform(rng, 4e3, 4e4)
    sharp_grey = 255 * light_at_heights(light, z_um, scene.truth_um).clip(0, 1)
    images = Camera(full_well_e, float(rng.uniform(0.2, 1.0))).shoot(light, 1.0, seed)
    field = Field(number=1, row=0, col=0, x_um=0.0, y_um=0.0, z_start_um=float(z_um[0]))
    aperture_known = bool(rng.random() < 0.5)
    stack = FieldStack(
        field, images, z_um, np.ones(n_frames, bool), PIXEL_UM, simulated=True,
        depth_of_field_um=depth_um if aperture_known else 0.0,
    )  # fmt: skip
    truth_um = scene.truth_um.astype(np.float64)
    steepest = float(np.hypot(*np.gradient(truth_um)).max())
    return Relief(seed, name, na, step_dof, WINDOW_PX * steepest / step_um, full_well_e, stack, truth_um, sharp_grey)


def _shape(name: str, shape: tuple[int, int], rng: np.random.Generator) -> Array:
    """Heights on the lattice, in units of their own."""
    down, right = lattice_um(shape, MARGIN_PX, PIXEL_UM)
    y, x = turned(down, right, float(rng.uniform(0, 360)))
    match name:
        case "plane":
            return x
        case "waves":
            length_um = _log_uniform(rng, 40, 160) * PIXEL_UM
            phase = float(rng.uniform(0, 2 * np.pi))
            return np.cos(2 * np.pi * x / length_um + phase) + rng.uniform(0, 1) * np.cos(2 * np.pi * y / length_um)
        case "bumps":
            half_um = np.array(shape) / 2 * PIXEL_UM
            heights = np.zeros_like(down)
            for _ in range(int(rng.integers(2, 7))):
                (row, col), wide_um = rng.uniform(-half_um, half_um), _log_uniform(rng, 10, 40) * PIXEL_UM
                heights += (
                    rng.choice([-1, 1]) * wide_um * np.exp(-((down - row) ** 2 + (right - col) ** 2) / (2 * wide_um**2))
                )
            return heights
        case "saddle":
            return x**2 - float(rng.uniform(0.3, 1.0)) * y**2
        case _:
            return blobs(down.shape, _log_uniform(rng, 12, 40), rng).astype(np.float64)


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
