"""Profiles of a session that stands still: one curve for every line, and no other surface to compare it with."""

from __future__ import annotations

import numpy as np

from wafer_viewer.model.measurement.measurements import Length, Profile, ProfileCurve
from wafer_viewer.model.measurement.sections import OtherSurface, Section, SectionRequest


class FakeSections:
    """The same hill over streets along every line."""

    def section(self, request: SectionRequest) -> Section:
        distance, along = np.linspace(0, 2100, 4000), np.linspace(0, 1, 4000)
        z = 34 * np.exp(-(((distance - 1320) / 110) ** 2)) + 1.2 * np.sin(distance / 20)
        z[(distance % 430) < 55] -= 12
        z[2000:2040] = np.nan
        a, b = request.line.points
        x_um, y_um = a.x_um + along * (b.x_um - a.x_um), a.y_um + along * (b.y_um - a.y_um)
        found = Profile(
            line=request.line,
            length_um=2100.0,
            pt=Length(value_um=47.6),
            rise=Length(value_um=33.91, expanded_um=0.42, status="evaluated"),
            measured_fraction=0.99,
            simulated=True,
        )
        return Section(request, found, ProfileCurve(distance, z, x_um, y_um), "coupon-07")

    def others(self) -> tuple[OtherSurface, ...]:
        return ()

    def file(self, sections: object, ending: str) -> bytes:
        return ending.encode()
