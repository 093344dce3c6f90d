"""Plots of surfaces and profiles for notebooks and scripts; matplotlib is imported when something is drawn."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from wafer_viewer.draw.colormaps import PROFILE_COLOURS, rgb, table
from wafer_viewer.draw.surface.display_style import DisplayStyle
from wafer_viewer.model.measurement.measurements import ProfileCurve
from wafer_viewer.model.surface.height_map import Mosaic

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_PX = 1500
"""Largest side of a plotted surface; a larger one is read at a coarser level."""
UNMEASURED = "#DEE2E7"
NEARLY_ALL = (0.5, 99.5)
"""Percentiles of heights that the colours cover."""


def plot_surface(surface: Mosaic, axes: Axes | None = None) -> Axes:
    """Draw the heights of a surface over x and y of the stage, with a colour bar; return the axes."""
    from matplotlib.colors import ListedColormap

    level = min(surface.levels - 1, max(0, math.ceil(math.log2(max(*surface.shape, 1) / MOST_PX))))
    part = surface.window(level=level)
    z_um, half = part.to_measure(), part.pixel_um / 2
    rows, cols = z_um.shape
    left, top = part.x0_um - half, part.y0_um + half
    known = z_um[np.isfinite(z_um)]
    low, high = np.percentile(known, NEARLY_ALL) if known.size else (0.0, 1.0)
    axes = axes or _new_axes()
    axes.set(xlabel="x, µm", ylabel="y, µm", facecolor=UNMEASURED)
    drawn = axes.imshow(
        z_um,
        cmap=ListedColormap(table(DisplayStyle().colours) / 255),
        vmin=float(low),
        vmax=float(high),
        extent=(left, left + cols * part.pixel_um, top - rows * part.pixel_um, top),
    )
    axes.figure.colorbar(drawn, ax=axes, label="Height, µm")
    if surface.provenance.simulated:
        axes.set_title("SIMULATED", loc="right")
    return axes


def plot_profile(curve: ProfileCurve, axes: Axes | None = None) -> Axes:
    """Draw the heights of a profile over the distance along its line, with gaps where unmeasured; return the axes."""
    axes = axes or _new_axes()
    axes.set(xlabel="Distance along the profile, µm", ylabel="z, µm")
    axes.plot(curve.distance_um, curve.z_um, color=np.array(rgb(PROFILE_COLOURS[0])) / 255)
    return axes


def _new_axes() -> Axes:
    """Return the axes of a new figure, which a notebook shows."""
    import matplotlib.pyplot

    return matplotlib.pyplot.subplots(layout="constrained")[1]
