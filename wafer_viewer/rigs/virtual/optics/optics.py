"""Imaging model of the virtual microscope: the image of one field of a scene at any focus height.

A point out of focus spreads to a Gaussian of
    sigma(z)^2 = (0.21 wavelength / NA)^2 + (NA (z - h) / 2)^2
so a field is blurred in advance at some thirty levels (blur_levels), and a frame is read from the two levels next to
each pixel's own sigma (frame_composition). Light bleeds over walls as in a microscope, because each sheet is blurred
together with the dark area that the other sheet covers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from wafer_viewer.rigs.virtual.optics.blur import FINE_MARGIN, Law, Plane, blur_law, coarse_window, make_levels
from wafer_viewer.rigs.virtual.optics.frame_composition import SceneHeights, compose, make_stretches
from wafer_viewer.rigs.virtual.scenes.catalogue import Scene, SceneWindow
from wafer_viewer.rigs.virtual.scenes.drawing import SceneSheets


@dataclass(frozen=True, slots=True)
class Optics:
    """Objective, light and pixel of the virtual microscope; by default 10x / 0.28 in green light."""

    na: float = 0.28
    wavelength_um: float = 0.55
    pixel_um: float = 0.46729

    @property
    def depth_of_field_um(self) -> float:
        """Depth of field lambda / NA^2 + e / (M NA) in air; e / M is the pixel size on the sample."""
        return self.wavelength_um / self.na**2 + self.pixel_um / self.na

    @property
    def sharpest_um(self) -> float:
        """Sigma of a point in focus."""
        return 0.21 * self.wavelength_um / self.na

    def sigma_um(self, defocus_um: float) -> float:
        """Return the sigma of a point defocus_um out of focus."""
        return math.hypot(self.sharpest_um, self.na * defocus_um / 2)


class FieldPicture:
    """Field of view, prepared for fast rendering of frames at any z.

    (x_um, y_um) is the centre of a frame of rows x cols. Frames outside z_range_um may have too little blur. A field of
    1080 x 1440 takes about 170 MB.
    """

    def __init__(
        self,
        scene: Scene,
        optics: Optics,
        x_um: float,
        y_um: float,
        rows: int,
        cols: int,
        z_range_um: tuple[float, float],
    ) -> None:
        frame = centred_window(x_um, y_um, rows, cols, optics.pixel_um)
        near = scene.raster(frame.grown(FINE_MARGIN))
        inner = SceneSheets(
            *(np.ascontiguousarray(p[FINE_MARGIN:-FINE_MARGIN, FINE_MARGIN:-FINE_MARGIN]) for p in near)
        )
        law = law_for(optics, inner, z_range_um)
        lattice = coarse_window(frame, law)
        far = scene.raster(lattice)
        self._law = law
        self._heights = SceneHeights(inner.height_a, inner.height_b)
        self._surface_um = inner.surface_um()
        self._levels = make_levels(frame, lattice, near, far, law)
        self._stretches = make_stretches(frame, inner.height_a, inner.height_b, lattice, far.cover)

    def radiance(self, z_um: float) -> Plane:
        """Return the image with the focus at z_um, float32 [row, col]; 1 is white at the scene's gain."""
        return compose(z_um, self._law, self._levels, self._heights, self._stretches)

    def truth(self) -> Plane:
        """Return the true height in um of every pixel, as seen from straight above. For tests only."""
        return self._surface_um


def centred_window(x_um: float, y_um: float, rows: int, cols: int, pixel_um: float) -> SceneWindow:
    """Return the window of a frame with a given centre."""
    return SceneWindow(x_um - (cols - 1) / 2 * pixel_um, y_um + (rows - 1) / 2 * pixel_um, pixel_um, rows, cols)


def law_for(optics: Optics, sheets: SceneSheets, z_range_um: tuple[float, float]) -> Law:
    """Return the blur law in pixels, with enough levels for every height of a field over a range of z."""
    lowest = min(sheets.height_a.min(), sheets.height_b.min())
    highest = max(sheets.height_a.max(), sheets.height_b.max())
    farthest = max(z_range_um[1] - lowest, highest - z_range_um[0])
    per_um = optics.na / 2 / optics.pixel_um
    return blur_law(optics.sharpest_um / optics.pixel_um, per_um**2, float(farthest))
