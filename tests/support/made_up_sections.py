"""Sections with known shapes that the tests of drawing and writing share."""

from __future__ import annotations

import numpy as np

from wafer_viewer.model.measurement.measurements import Length, Profile, ProfileCurve
from wafer_viewer.model.measurement.sections import Section, SectionRequest
from wafer_viewer.model.region import Region


def section_of(z_um, place: int = 0, step_um: float = 0.5, simulated: bool = True, **requested) -> Section:
    """A section along x from (0, 10 * place) with heights a step apart."""
    z = np.asarray(z_um, float)
    along = np.arange(len(z)) * step_um
    line = Region.line(0, 10 * place, along[-1], 10 * place)
    known = z[np.isfinite(z)]
    found = Profile(
        line=line,
        length_um=float(along[-1]),
        pt=Length(value_um=float(np.ptp(known)) if known.size else 0.0),
        rise=Length(value_um=0.0),
        measured_fraction=1.0,
        simulated=simulated,
        surface="filled" if requested.get("cleaned") else "unsmoothed",
    )
    curve = ProfileCurve(along, z, along, np.full(len(z), 10.0 * place))
    return Section(SectionRequest(place, line, **requested), found, curve, "coupon-07")


def hill(n: int = 6001, height_um: float = 20.0) -> np.ndarray:
    """A hill in the middle of a plain."""
    return height_um * np.exp(-(((np.arange(n) - n / 2) / (n / 12)) ** 2))
