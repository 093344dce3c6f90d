"""Implementations of the focus measures: compiled kernels, or plain functions that are applied frame by frame."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import ComputeError
from wafer_viewer.model.surface.focus_measures import FocusMeasure, focus_measures
from wafer_viewer.reconstruct.focus.focus_volume import (
    Focusing,
    FocusKernels,
    Volume,
    accumulate_levels,
    fraction_table,
)
from wafer_viewer.reconstruct.focus.log_laplacian import Stabiliser
from wafer_viewer.reconstruct.frame_blocks import StackSource

FocusFunction = Callable[[NDArray[np.float32], int], NDArray[Any]]

_BITS, _OFFSET = 9, 64
"""A level of a plain function is 2^9 (log2 of the focus + 64), which holds every scale from 2^-64 to 2^64."""


@cache
def focus_kernels(name: str) -> FocusKernels:
    """Return the implementation of a focus measure. Raises ComputeError if it cannot be imported."""
    measure = focus_measures()[name]
    module, _, attribute = measure.implementation.partition(":")
    try:
        found = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as fault:
        raise ComputeError(
            f"The focus measure '{name}' cannot be imported from {measure.implementation} ({fault}): update or remove "
            "the package that brings it."
        ) from fault
    return found if isinstance(found, FocusKernels) else kernels_of_function(measure, found)


def kernels_of_function(measure: FocusMeasure, function: FocusFunction) -> FocusKernels:
    """Return an implementation that applies a plain function to one frame of a block after the other."""
    return FocusKernels(lambda _: fraction_table(_BITS), lambda *_: None, partial(_fill, measure, function))


def _fill(
    measure: FocusMeasure, function: FocusFunction, source: StackSource, how: Focusing, _: None, volume: Volume
) -> None:
    """Measure the frames of a source, each with the margin of the window; image borders repeat."""
    margin, (n_rows, cols) = measure.margin_px(how.window), volume.best.shape
    around = np.ix_(
        _with_margin(source.top, n_rows, margin, source.images.shape[1]),
        _with_margin(source.left, cols, margin, source.images.shape[2]),
    )
    for level, slot in zip(volume.levels, source.slots, strict=True):
        image = source.images[slot][around].astype(np.float32)
        if measure.uses_camera_noise:
            scale, offset = Stabiliser.of(how.camera)
            image = np.sqrt(image * np.float32(scale) + np.float32(offset))
        focus = np.asarray(function(image, how.window))
        if focus.shape != image.shape:
            raise ComputeError(
                f"The focus measure '{measure.name}' returns an array of shape {focus.shape} for an image of shape "
                f"{image.shape}: it must return one value for each pixel."
            )
        level[:] = _levels(focus[margin : margin + n_rows, margin : margin + cols])
    accumulate_levels(source, volume)


def _with_margin(start: int, length: int, margin: int, size: int) -> NDArray[np.int64]:
    return np.arange(start - margin, start + length + margin).clip(0, size - 1)


def _levels(focus: NDArray[Any]) -> NDArray[np.uint16]:
    """Return log2 of the focus as 16 bits; 0 where there is none."""
    with np.errstate(all="ignore"):
        level = (np.log2(focus.astype(np.float32)) + _OFFSET) * 2**_BITS + 0.5
    return np.nan_to_num(level, nan=0.0).clip(0, 65535).astype(np.uint16)
