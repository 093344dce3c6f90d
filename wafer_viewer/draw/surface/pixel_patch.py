"""Enlarged patch of a frame as an image."""

from __future__ import annotations

import base64
import io

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import Image

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

    seen = patch(image, row, col, side_px)
    low, high = between
    grey = np.clip((seen - low) * (255 / (high - low)), 0, 255).astype(np.uint8)
    whole = np.zeros((side_px, side_px, 2), np.uint8)
    r, c = max(0, side_px // 2 - row), max(0, side_px // 2 - col)
    whole[r : r + seen.shape[0], c : c + seen.shape[1]] = _opaque(grey)
    file = io.BytesIO()
    Pictures.fromarray(whole, "LA").save(file, "PNG", compress_level=1)
    return f"data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}"


def _opaque(grey: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.dstack([grey, np.full_like(grey, 255)])
