"""Pictures for comparison: surfaces side by side in one range, and an enlarged patch of a frame."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.draw.colormaps import DIVERGING, table
from wafer_viewer.draw.surface.mesh import jpeg
from wafer_viewer.draw.surface.texture_baking import light_gain, shade, without_gaps
from wafer_viewer.model.acquisition.focus_stack import Image

Plane = NDArray[np.float32]
COLOURS = "mako"
UNMEASURED = np.array([200, 208, 216], np.uint8)
LEAST_SPAN_UM, LEAST_SPAN_GREY = 0.2, 24.0
_ENDS, _INNER_ENDS = (0.5, 99.5), (2.0, 98.0)
_QUALITY, _HILLSHADE = 88, 0.5


@dataclass(frozen=True, slots=True)
class Range:
    """Limits of the colour scale and its zero value; gain: of the lighting, 0 without any; colours: '' for greys."""

    low: float
    high: float
    zero: float = 0.0
    gain: float = 0.0
    colours: str = ""


def heights_of(planes: Sequence[Plane], inside: Plane, pixel_um: float) -> Range:
    """Return a common height range that does not clip the region `inside`.

    Zero is the median of the second plane, or of the first if there is no second; the lighting gain is that of the
    first.
    """
    low, high = _ends(planes, _ENDS)
    if np.isfinite(inside).any():
        least, most = np.nanpercentile(inside, _INNER_ENDS)
        low, high = min(low, float(least)), max(high, float(most))
    spare = max(0.0, LEAST_SPAN_UM - (high - low)) / 2
    measured = [plane[np.isfinite(plane)] for plane in (*planes[1:2], planes[0])]
    zero = next((float(np.median(values)) for values in measured if values.size), 0.0)
    return Range(low - spare, high + spare, zero, light_gain(planes[0], pixel_um), COLOURS)


def greys_of(planes: Sequence[Plane]) -> Range:
    """Return the common grey range of all images."""
    low, high = _ends(planes, _ENDS)
    spare = max(0.0, LEAST_SPAN_GREY - (high - low)) / 2
    return Range(low - spare, high + spare)


def difference_of(planes: Sequence[Plane], inside: Plane, least_span: float) -> Range:
    """Return a symmetric range of differences, in diverging colours, that does not clip the region `inside`."""
    most = max(map(abs, (*_ends(planes, _ENDS), *_ends([inside], _INNER_ENDS)))) if len(planes) else 0.0
    half = max(most, least_span / 2)
    return Range(-half, half, colours=DIVERGING)


def picture_of(plane: Plane, pixel_um: float, over: Range) -> bytes:
    """Return values as colours, lit if the range says so, or as greys; unknown pixels have a uniform colour."""
    measured = np.isfinite(plane)
    if not measured.any():
        return b""
    filled = without_gaps(plane)
    share = np.clip((filled - over.low) / max(over.high - over.low, 1e-9), 0, 1)
    index = (share * 255).astype(np.uint8)
    colour = table(over.colours)[index].astype(np.float32) if over.colours else np.repeat(index[..., None], 3, 2)
    if over.gain:
        light = shade(filled, pixel_um, over.gain, over.high - over.low).lambert
        colour = colour * (1 + np.float32(0.85 * _HILLSHADE) * (np.minimum(light, 1.6) - 1))[..., None]
    pixels = np.clip(colour, 0, 255).astype(np.uint8)
    return jpeg(np.where(measured[..., None], pixels, UNMEASURED), _QUALITY)


def _ends(planes: Sequence[Plane], ends: tuple[float, float]) -> tuple[float, float]:
    measured = [plane[np.isfinite(plane)] for plane in planes]
    values = np.concatenate([*measured, np.zeros(0, np.float32)])
    if values.size == 0:
        return 0.0, 1.0
    low, high = np.percentile(values, ends)
    return float(low), float(high)


LEAST_SPAN = 1 / 8
"""Least displayed range as a share of the grey range, so that noise does not look like texture."""
Greys = tuple[float, float]


def patch(image: Image, row: int, col: int, side_px: int) -> Image:
    """Return the square of `side_px` around a pixel, cropped at the frame edges."""
    top, left = row - side_px // 2, col - side_px // 2
    return image[max(0, top) : max(0, top + side_px), max(0, left) : max(0, left + side_px)]


def greys(image: Image) -> Greys:
    """Return the grey values shown as black and white: the 0.5 and 99.5 percentiles, at least `LEAST_SPAN` apart."""
    low, high = (float(v) for v in np.percentile(image, (0.5, 99.5)))
    spare = max(0.0, LEAST_SPAN * np.iinfo(image.dtype).max - (high - low)) / 2
    return low - spare, high + spare


def patch_url(image: Image, row: int, col: int, side_px: int, between: Greys) -> str:
    """Return the square around a pixel as a PNG data URL; pixels outside the frame are transparent."""
    from PIL import Image as Pictures

    pixels = patch(image, row, col, side_px)
    low, high = between
    grey = np.clip((pixels - low) * (255 / (high - low)), 0, 255).astype(np.uint8)
    canvas = np.zeros((side_px, side_px, 2), np.uint8)
    r, c = max(0, side_px // 2 - row), max(0, side_px // 2 - col)
    canvas[r : r + pixels.shape[0], c : c + pixels.shape[1]] = _opaque(grey)
    file = io.BytesIO()
    Pictures.fromarray(canvas, "LA").save(file, "PNG", compress_level=1)
    return f"data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}"


def _opaque(grey: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.dstack([grey, np.full_like(grey, 255)])
