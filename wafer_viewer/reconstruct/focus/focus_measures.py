"""Registry of the focus measures, with the functions that the search needs of each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.reconstruct.focus.focus_volume import StackSource, Volume
from wafer_viewer.reconstruct.focus.log_laplacian import (
    LEVEL_BITS,
    LogRows,
    Stabiliser,
    log_laplacian_block,
    log_margin_px,
)
from wafer_viewer.reconstruct.focus.sml_tenengrad_glv import (
    GLV,
    SML,
    TENENGRAD,
    Rows,
    focus_block,
    focus_values,
    paper_margin_px,
)
from wafer_viewer.reconstruct.preprocess.camera_noise import CameraNoise

Table = NDArray[np.float32]

USUAL_CAMERA = CameraNoise(gain_counts=0.02, floor_counts2=0.2)
"""8 bits over 13 000 electrons, and noise of a third of a grey level."""


@dataclass(frozen=True, slots=True)
class Focusing:
    """Parameters of a focus measure: window and, where it uses them, camera noise and high-pass along z."""

    window: int
    camera: CameraNoise = USUAL_CAMERA
    lag: int = 0


@dataclass(frozen=True, slots=True)
class FocusMeasure:
    """A focus measure: title, source, and the functions that the search needs.

    power: the measure falls as the blur variance to minus this power. The energy of white texture under a Gaussian blur
    of variance v goes as 1 / v^2 for first and 1 / v^3 for second derivatives; the power of the variance in a window,
    which removes the mean, was measured, and the power of a mean of logarithms equals that of its energy. margin_px:
    reach of a window beyond a pixel. table: contribution of the lower bits of a level to log2, the other bits being the
    integer part. make_rows: allocates the work rows of the kernel, for a number of columns, a window and a dtype. fill:
    measures the frames of a source into a volume.
    """

    title: str
    source: str
    power: float
    margin_px: Callable[[int], int]
    table: Callable[[np.dtype[Any]], Table]
    make_rows: Callable[[int, int, np.dtype[Any]], Any]
    fill: Callable[[StackSource, Focusing, Any, Volume], None]


def _of_the_paper(title: str, equation: str, power: float, code: int) -> FocusMeasure:
    fill = partial(_fill_by_energy, code)
    return FocusMeasure(title, equation, power, paper_margin_px, _mantissa_table, Rows.make, fill)


def _fill_by_energy(code: int, source: StackSource, how: Focusing, rows: Rows, volume: Volume) -> None:
    focus_block(source, code, how.window, rows, volume)


def _fill_by_logarithm(source: StackSource, how: Focusing, rows: LogRows, volume: Volume) -> None:
    log_laplacian_block(source, how.window, Stabiliser.of(how.camera), how.lag, rows, volume)


def _mantissa_table(dtype: np.dtype[Any]) -> Table:
    """Return log2(1 + fraction) for levels that are the bits of a float32, five or six of them before the point."""
    bits = 11 if np.dtype(dtype).itemsize == 1 else 10
    return np.log2(1 + np.arange(2**bits) / 2**bits).astype(np.float32)


def _linear_table(dtype: np.dtype[Any]) -> Table:
    """Return the table for levels that are logarithms with the same number of fraction bits for every dtype."""
    return (np.arange(2**LEVEL_BITS) / 2**LEVEL_BITS).astype(np.float32)


FOCUS_MEASURES: dict[str, FocusMeasure] = {
    "sml": _of_the_paper("Sum of the squared second derivatives", "eq. 2", 3.0, SML),
    "tenengrad": _of_the_paper("Sum of the squared Sobel gradients", "eq. 3", 2.0, TENENGRAD),
    "glv": _of_the_paper("Variance of the grey levels", "eq. 4", 1.7, GLV),
    "log_laplacian": FocusMeasure(
        "Mean logarithm of a Laplacian's energy over the camera's noise",
        "log_laplacian.py",
        3.0,
        log_margin_px,
        _linear_table,
        LogRows.make,
        _fill_by_logarithm,
    ),
}

_CODES = {"sml": SML, "tenengrad": TENENGRAD, "glv": GLV}
PAPER_MEASURES = tuple(_CODES)


def focus_image(image: Image, measure: str, window: int) -> NDArray[np.float32]:
    """Return the focus measure of one image [row, col], eq. 2, 3 or 4, as float32 of the same shape.

    Beyond the border the border pixels repeat. Raises KeyError for a measure that is not one of the paper's.
    """
    source = StackSource.of(np.ascontiguousarray(image)[None], np.zeros(1, np.int64), 0, 0, 0)
    out = np.empty(image.shape, np.float32)
    focus_values(source, _CODES[measure], window, Rows.make(image.shape[1], window, image.dtype), out)
    return out / np.float32(window * window) if measure == "glv" else out
