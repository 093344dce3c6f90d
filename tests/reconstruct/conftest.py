"""Stacks with a known height: a random texture, blurred as a microscope blurs, with noise."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.acquisition.plan import Field
from wafer_viewer.model.surface.height_map import HeightMap, Origin, Provenance
from wafer_viewer.reconstruct.frame_blocks import Correction, Frames, StackWindow, read_part

PIXEL_UM = 0.5
_SHARPEST_PX, _PX_PER_UM = 0.8, 0.3
_VARIANCES = np.array([0.64, 1, 1.5, 2.2, 3.2, 4.6, 6.5, 9, 13, 19, 27, 39, 56, 80, 115, 165])

MakeStack = Callable[..., FieldStack]
MakeMap = Callable[..., HeightMap]
Kind = TypeVar("Kind", bound=Correction)


def a_field(number: int = 1, x_um: float = 0.0, y_um: float = 0.0) -> Field:
    return Field(number=number, row=0, col=number - 1, x_um=x_um, y_um=y_um, z_start_um=0.0)


def correction(frames: Frames, kind: type[Kind]) -> Kind | None:
    """The correction of a kind that frames have."""
    return next((one for one in frames.corrections if isinstance(one, kind)), None)


def whole_field(frames: Frames) -> NDArray:
    """All pixels of all frames, corrected."""
    return read_part(frames, StackWindow(*(slice(0, n) for n in frames.shape)))


def _blurred(levels: NDArray, height_um: NDArray, z_um: float) -> NDArray:
    """Blur by sigma^2 = sharpest^2 + (px per um x defocus)^2, read between levels of blur, one per variance."""
    variance = np.clip(_SHARPEST_PX**2 + (_PX_PER_UM * (z_um - height_um)) ** 2, _VARIANCES[0], _VARIANCES[-1])
    at = np.interp(variance, _VARIANCES, np.arange(len(_VARIANCES)))
    low = np.minimum(at.astype(int), len(_VARIANCES) - 2)
    part = at - low
    rows, cols = np.indices(height_um.shape)
    return levels[low, rows, cols] * (1 - part) + levels[low + 1, rows, cols] * part


@pytest.fixture(scope="session")
def make_stack() -> MakeStack:
    def make(
        height_um: NDArray,
        z_um: NDArray,
        *,
        noise_counts: float = 0.5,
        contrast: NDArray | float = 1.0,
        dtype: type = np.uint8,
        seed: int = 1,
        **changes: object,
    ) -> FieldStack:
        rng = np.random.default_rng(seed)
        texture = rng.normal(0, 60, height_um.shape)
        levels = np.stack([gaussian_filter(texture, np.sqrt(v)) for v in _VARIANCES])
        frames = [
            110 + contrast * _blurred(levels, height_um, z) + rng.normal(0, noise_counts, height_um.shape) for z in z_um
        ]
        scale = 1 if dtype is np.uint8 else 16
        images = np.clip(np.rint(np.stack(frames) * scale), 0, 255 * scale).astype(dtype)
        settings = {"present": np.ones(len(z_um), bool), "pixel_um": PIXEL_UM, "field": a_field(), **changes}
        return FieldStack(images=images, z_um=np.asarray(z_um, float), **settings)

    return make


@pytest.fixture(scope="session")
def make_map() -> MakeMap:
    def make(z_um: NDArray, x0_um: float = 0.0, y0_um: float = 0.0, **changes: object) -> HeightMap:
        z = np.asarray(z_um, np.float32)
        layers = {
            "z_um": z,
            "z_raw_um": z.copy(),
            "confidence": np.isfinite(z).astype(np.float32),
            "all_in_focus": np.full(z.shape, 100, np.uint8),
            "origin": np.where(np.isfinite(z), Origin.MEASURED, Origin.AMBIGUOUS).astype(np.uint8),
            "pixel_um": PIXEL_UM,
            "provenance": Provenance(z_step_um=4.0),
        }
        return HeightMap(**{**layers, **changes}, x0_um=x0_um, y0_um=y0_um)

    return make


@pytest.fixture(scope="session")
def plane_um() -> NDArray:
    rows, cols = np.indices((96, 128))
    return 50 + 0.12 * cols + 0.05 * rows


@pytest.fixture(scope="session")
def plane_stack(make_stack: MakeStack, plane_um: NDArray) -> FieldStack:
    return make_stack(plane_um, np.arange(20.0, 104.0, 4.0))
