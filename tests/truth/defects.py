"""Patterned wafers with planted defects as a scan leaves them behind: what finding defects is judged by.

    made = make(Plan(seed=3))           # 9 x 8 dies, 5.6 Mpx, half a minute on one core
    made.surface                        # a HeightMap: heights, picture and reasons, reconstructed from focus stacks
    made.planted, made.truth_um         # what is wrong, and the true heights

Every field is a focus stack rendered through the virtual optics, with the noise of its camera, reconstructed with the
default recipe; the fields are laid side by side where they belong, so errors of stitching are not in it. Heights are
multiples of the deviation of the reconstructed heights from the true ones on die tops (`height_noise_um`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from tests.truth.patterned import scene_of
from tests.truth.planted import DEPTH_UM, PITCH_PX, PIXEL_UM, STREET_PX, Plan, Planted, planted
from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.acquisition.plan import Field
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.reconstruct.field_pipeline import reconstruct
from wafer_viewer.rigs.virtual.camera import Sensor
from wafer_viewer.rigs.virtual.optics.optics import FieldPicture, Optics
from wafer_viewer.rigs.virtual.scenes.catalogue import Scene

FIELD_PX = (1020, 1360)
"""The largest part of a field that is used, (rows, cols)."""
CROP_PX = 16
"""Of each field's border, where its windows reach beyond it."""
_LAYERS = ("z_um", "z_raw_um", "confidence", "all_in_focus", "origin")
Floats = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Made:
    """A reconstructed wafer, what was planted on it, its true heights, and the noise that heights are told in."""

    plan: Plan
    surface: HeightMap
    planted: tuple[Planted, ...]
    truth_um: Floats
    sigma_um: float

    @property
    def area_mm2(self) -> float:
        """Of the pixels."""
        return self.truth_um.size * (PIXEL_UM / 1000) ** 2

    @property
    def unmeasured(self) -> float:
        """The share of pixels without a height."""
        return float(np.isnan(self.surface.z_raw_um).mean())


def make(plan: Plan, sigma_um: float | None = None) -> Made:
    """Render, reconstruct and lay a wafer; one thread."""
    sigma = height_noise_um() if sigma_um is None else sigma_um
    what = planted(plan, sigma)
    surface, truth = _laid(plan, scene_of(plan, what))
    return Made(plan, surface, what, truth, sigma)


@lru_cache(maxsize=1)
def height_noise_um() -> float:
    """Robust deviation of the measured heights from the true ones, on a die's top away from walls."""
    plan = Plan(cols=2, rows=2, seed=90_001, defective=0.0, odd_dies=False)
    surface, truth = _laid(plan, scene_of(plan, ()))
    error = (surface.z_raw_um - truth)[_inner_dies(plan)]
    error = error[np.isfinite(error)]
    return float(1.4826 * np.median(np.abs(error - np.median(error))))


def _inner_dies(plan: Plan) -> NDArray[np.bool_]:
    """Pixels at least 16 px inside of a die."""
    from_wall = STREET_PX // 2 + 16
    rows, cols = (np.arange(n) - plan.margin_px for n in plan.shape)
    down, across = (np.mod(at, pitch) for at, pitch in ((rows, PITCH_PX[1]), (cols, PITCH_PX[0])))
    inner_rows = (down > from_wall) & (down < PITCH_PX[1] - from_wall)
    return inner_rows[:, None] & ((across > from_wall) & (across < PITCH_PX[0] - from_wall))[None, :]


def _laid(plan: Plan, scene: Scene) -> tuple[HeightMap, Floats]:
    """All fields of a plan side by side."""
    full: dict[str, NDArray] = {}
    truth = np.empty(plan.shape, np.float32)
    one = None
    for n, (rows, cols) in enumerate(_parts(plan.shape)):
        stack, true = field_of(plan, scene, rows, cols, n)
        one = reconstruct(stack, Recipe(), threads=1)
        inner = slice(CROP_PX, -CROP_PX), slice(CROP_PX, -CROP_PX)
        truth[rows, cols] = true[inner]
        for name in _LAYERS:
            layer = getattr(one, name)
            full.setdefault(name, np.empty(plan.shape, layer.dtype))[rows, cols] = layer[inner]
    x0_um, y0_um = first_um(plan)
    assert one is not None
    return dataclasses.replace(one, **full, u_um=None, x0_um=x0_um, y0_um=y0_um), truth


def first_um(plan: Plan) -> tuple[float, float]:
    """Stage um of pixel (0, 0)."""
    return (0.5 - plan.margin_px) * PIXEL_UM, plan.size_um[1] + (plan.margin_px - 0.5) * PIXEL_UM


def _parts(shape: tuple[int, int]) -> Iterator[tuple[slice, slice]]:
    """The fields' parts of a mosaic, as even as can be."""
    cuts = [np.linspace(0, n, -(-n // most) + 1).round().astype(int) for n, most in zip(shape, FIELD_PX, strict=True)]
    for top, bottom in zip(cuts[0], cuts[0][1:], strict=False):
        for left, right in zip(cuts[1], cuts[1][1:], strict=False):
            yield slice(top, bottom), slice(left, right)


def field_of(plan: Plan, scene: Scene, rows: slice, cols: slice, n: int) -> tuple[FieldStack, Floats]:
    """The focus stack of a part with its border, and the true heights."""
    shape = rows.stop - rows.start + 2 * CROP_PX, cols.stop - cols.start + 2 * CROP_PX
    x0_um, y0_um = first_um(plan)
    x_um = x0_um + ((cols.start + cols.stop - 1) / 2) * PIXEL_UM
    y_um = y0_um - ((rows.start + rows.stop - 1) / 2) * PIXEL_UM
    z_um = scene.tour_z_start_um + scene.tour_z_step_um * np.arange(scene.tour_frames)
    sensor = Sensor(*shape)
    picture = FieldPicture(scene, Optics(), x_um, y_um, *shape, (float(z_um[0]) - 5, float(z_um[-1]) + 5))
    first = 1000 * (plan.seed * 1000 + n)
    images = np.stack([sensor.expose(picture.radiance(z), scene.gain, first + k) for k, z in enumerate(z_um)])
    field = Field(number=1, row=0, col=0, x_um=x_um, y_um=y_um, z_start_um=float(z_um[0]))
    return FieldStack(field, images, z_um, np.ones(len(z_um), bool), PIXEL_UM, simulated=True), picture.truth()


__all__ = ["DEPTH_UM", "Made", "Plan", "Planted", "height_noise_um", "make"]
