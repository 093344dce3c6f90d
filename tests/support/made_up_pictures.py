"""Pictures with known edges: blurred as optics blur, with noise, in whole grey values of eight bits."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from tests.support.surfaces import PIXEL_UM, calibration, coordinates, noise_of, surface_of
from wafer_viewer.measure.edges.edge_search import SearchStrip
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import HeightMap

DARK, BRIGHT, BLUR_PX, NOISE = 60.0, 180.0, 1.2, 3.0


def picture(inside_px, blur_px=BLUR_PX, noise=NOISE, seed=0, dark=DARK, bright=BRIGHT, correlation_px=0.0):
    """Grey values, uint8, of what is bright where `inside_px`, the distance inside of an edge, is positive."""
    grey = dark + (bright - dark) * ndtr(np.asarray(inside_px) / blur_px)
    grey = grey + noise_of(seed, grey.shape, noise, correlation_px)
    return np.clip(np.round(grey), 0, 255).astype(np.uint8)


def pixels(rows, cols):
    """x and y of pixels about the middle, y upwards, in pixels."""
    x_um, y_um = coordinates(rows, cols)
    return np.meshgrid(x_um / PIXEL_UM, y_um / PIXEL_UM)


def edge(off_px=0.3, slope=0.02, rows=300, cols=80, **about):
    """Bright to the right of an edge through (off, 0); slope: of x over y."""
    x, y = pixels(rows, cols)
    return picture((x - off_px - slope * y) / np.hypot(1, slope), **about)


def kerf(width_px=38.4, slope=0.01, wedge=0.0, off_px=0.2, rows=300, cols=100, bright_kerf=True, **about):
    """An upright kerf, `wedge` wider for each pixel further up."""
    x, y = pixels(rows, cols)
    half = (width_px + wedge * y) / 2
    inside = half - np.abs(x - off_px - slope * y) / np.hypot(1, slope) * np.hypot(1, 0)
    return picture(inside if bright_kerf else -inside, **about)


def die(width_px=700.3, height_px=512.7, turn_deg=1.3, rows=620, cols=800, **about):
    """A bright die, turned counter-clockwise."""
    x, y = pixels(rows, cols)
    cos, sin = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    u, v = x * cos + y * sin, -x * sin + y * cos
    return picture(np.minimum(width_px / 2 - np.abs(u), height_px / 2 - np.abs(v)), **about)


def disc(radius_px=30.3, x_px=0.0, y_px=0.0, side=160, **about):
    """A bright disc."""
    x, y = pixels(side, side)
    return picture(radius_px - np.hypot(x - x_px, y - y_px), **about)


def chipped_edge(chips=((0.0, 9.0),), slope=0.01, rows=160, cols=400, **about):
    """A bright die below a level edge, out of which half discs (x, radius) are missing."""
    x, y = pixels(rows, cols)
    inside = (slope * x - y) / np.hypot(1, slope)
    for at, radius in chips:
        inside = np.minimum(inside, np.hypot(x - at, y - slope * at) - radius)
    return picture(inside, **about)


def strip(grey) -> SearchStrip:
    """As search lines along x; one um a pixel, (0, 0) in the middle."""
    rows, cols = grey.shape
    return SearchStrip.of(grey, 1.0, -(cols - 1) / 2, (rows - 1) / 2)


def surface(grey, z_um=None, **about) -> HeightMap:
    """A surface with that picture; the pixel is known without uncertainty."""
    import dataclasses

    about.setdefault("calibration", calibration())
    made = surface_of(np.zeros(grey.shape) if z_um is None else z_um, z_step_um=1.0, **about)
    return dataclasses.replace(made, all_in_focus=grey)


def all_of(made: HeightMap, less_px=0) -> Region:
    """A rectangle over a surface, some pixels less on each side."""
    x0, y0, x1, y1 = made.bounds_um
    by = less_px * PIXEL_UM
    return Region.rectangle(x0 + by, y0 + by, x1 - by, y1 - by)


def covered(errors, expanded) -> float:
    """Of all errors: the share that the expanded uncertainty covers."""
    return float(np.mean(np.abs(errors) <= np.asarray(expanded, float)))
