"""Pictures of a scene whose first rows say where they were taken."""

from __future__ import annotations

import numpy as np

from tests.bench.recipes import DEFAULT
from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.reconstruct.field_pipeline import reconstruct
from wafer_viewer.rigs.virtual.rig import PIXEL_UM

PLACE_ROWS = 2


class PlacedScene:
    """Wraps a renderer: the first PLACE_ROWS rows of its pictures hold the true place."""

    def __init__(self, renderer):
        self.renderer = renderer

    def frame(self, x_um, y_um, z_um, exposure_us, seed):
        image = self.renderer.frame(x_um, y_um, z_um, exposure_us, seed).copy()
        image[:PLACE_ROWS] = 0
        image[0, :24] = np.frombuffer(np.array([x_um, y_um, z_um]).tobytes(), np.uint8)
        return image


def placed_at(image):
    """The true place (x, y, z) of a picture."""
    return np.frombuffer(image[0, :24].tobytes(), np.float64)


def pictured(image):
    """The rows of the scene alone."""
    return image[PLACE_ROWS:]


def raw_heights_um(frames, field):
    """Unfiltered heights of a field, of frames by their shots."""
    stack = [frames[shot] for shot in sorted(frames, key=lambda shot: shot.k) if shot.field == field.number]
    images, z_um = np.stack([pictured(f.image) for f in stack]), np.array([f.z_um for f in stack])
    return reconstruct(FieldStack(field, images, z_um, np.ones(len(stack), bool), PIXEL_UM), DEFAULT).z_raw_um
