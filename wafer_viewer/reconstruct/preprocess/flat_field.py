"""Correction of the all-in-focus image by the flat field of the camera.

The shading of a pixel is constant over z: it multiplies the focus curve of the pixel and does not move its peak. So the
frames stay as they are, and the one image that is made of them is corrected, from which overlaps are registered and the
texture of the surface is blended.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from wafer_viewer.model.acquisition.flat_field import ImageShading
from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.reconstruct.preprocess.exposure_fusion import Fusion


def without_shading(picture: Image, shading: ImageShading | None, fusion: Fusion | None = None) -> Image:
    """Return an image as a camera of equal sensitivity and without a dark level takes it.

    fusion: of the exposures that the image was made of, in whose counts it is.
    """
    if shading is None:
        return picture
    dark = shading.dark_counts
    if fusion is not None:
        dark = np.float32(fusion.scale) * (dark - np.float32(fusion.black_counts))
    light = (picture - dark) / shading.sensitivity
    counts: Any = np.clip(np.rint(light), 0, np.iinfo(picture.dtype).max)
    return counts.astype(picture.dtype)
