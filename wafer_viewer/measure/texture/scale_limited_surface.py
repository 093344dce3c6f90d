"""Scale-limited surface of ISO 25178-3: a face as a lattice without form, shortest and longest waves."""

from __future__ import annotations

import numpy as np

from wafer_viewer.measure.base.area_samples import Area
from wafer_viewer.measure.base.height_samples import Floats
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.tool_options import TextureOptions
from wafer_viewer.numerics.filters.iso_gaussian import gaussian_mean
from wafer_viewer.numerics.filters.polynomial_fit import polynomial

FORMS = {0: "Form removed: the mean alone.", 1: "Form removed: plane of least squares."}
UNFILTERED = "Neither S-filter nor L-filter: noise and waviness are in the numbers."
BORDERS = (
    "Filter at borders and holes: weights scaled to sum one (ISO 16610-28, moment criterion of order 0); nothing from "
    "outside of the region."
)


def lattice_of(area: Area) -> Floats:
    """Return the heights of a face, float64 [row, col] of its bounding rectangle; NaN where there are none."""
    points, pixel_um = area.points, area.pixel_um
    rows = np.rint((points.y_um.max() - points.y_um) / pixel_um).astype(np.intp)
    cols = np.rint((points.x_um - points.x_um.min()) / pixel_um).astype(np.intp)
    z_um = np.full((int(rows.max()) + 1, int(cols.max()) + 1), np.nan)
    z_um[rows, cols] = points.z_um
    return z_um


def scale_limited(z_um: Floats, pixel_um: float, options: TextureOptions) -> Floats:
    """Remove form, S-filtered and L-filtered waves from heights [row, col]; the result has zero mean.

    The S-filter is applied to the residual from the form: it preserves polynomials, and a tilt causes no edge effects.
    Raises MeasureError where a filter is longer than the face, or its points do not determine the form.
    """
    _require_room(z_um.shape, pixel_um, options)
    left = _without_form(z_um - np.nanmean(z_um), options.form_order)
    if options.s_filter_um is not None:
        left = _without_form(gaussian_mean(left, options.s_filter_um / pixel_um), options.form_order)
    if options.l_filter_um is not None:
        left = left - gaussian_mean(left, options.l_filter_um / pixel_um)
    return left - np.nanmean(left)


def filter_words(options: TextureOptions) -> str:
    """Return the description of the filters for a result."""
    named = (("S", options.s_filter_um), ("L", options.l_filter_um))
    told = [f"{name} {cutoff_um:g} um" for name, cutoff_um in named if cutoff_um is not None]
    return f"Gaussian (ISO 16610-61), {', '.join(told)}" if told else "none"


def form_notes(options: TextureOptions) -> tuple[str, ...]:
    """Return notes on the removed form and on the filter borders."""
    form = FORMS.get(options.form_order, f"Form removed: polynomial of least squares of order {options.form_order}.")
    return form, UNFILTERED if filter_words(options) == "none" else BORDERS


def _require_room(shape: tuple[int, ...], pixel_um: float, options: TextureOptions) -> None:
    narrowest_um = min(shape) * pixel_um
    for name, cutoff_um in (("S", options.s_filter_um), ("L", options.l_filter_um)):
        if cutoff_um is not None and cutoff_um > narrowest_um:
            raise MeasureError(
                f"The {name}-filter of {cutoff_um:g} um is longer than the face, {narrowest_um:.4g} um at its "
                "narrowest: draw it larger or take a shorter filter."
            )


def _without_form(z_um: Floats, order: int) -> Floats:
    form = polynomial(z_um, order)
    if form is None:
        raise MeasureError(
            f"The measured points of the face do not determine a form of order {order}: draw it larger or lower the "
            "order."
        )
    return z_um - form
