"""Front-surface site ranges of a wafer measured on one side, as mounted."""

from __future__ import annotations

from wafer_viewer.model.measurement.measurement import MeasurementResult
from wafer_viewer.model.quantity import Length, Quantity
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import Fraction, Positive, Spec


class Site(Spec, frozen=True, kw_only=True):
    """One site with its centre in stage um; range is None if too little of it is measured."""

    x_um: float
    y_um: float
    range: Length | None
    measured_fraction: Fraction = 0.0


class SiteRanges(MeasurementResult, frozen=True, kw_only=True, tag="site_range"):
    """Front-surface site ranges, as mounted, row by row from the top left; `largest` of the measured ones.

    Rows and columns count complete sites; the remaining border belongs to none.
    """

    region: Region
    site_width_um: Positive
    site_height_um: Positive
    rows: int
    cols: int
    sites: tuple[Site, ...]
    largest: Length

    @property
    def outlines(self) -> tuple[Region, ...]:
        """Rectangles of all sites, in their order."""
        x, y = self.site_width_um / 2, self.site_height_um / 2
        return tuple(Region.rectangle(s.x_um - x, s.y_um - y, s.x_um + x, s.y_um + y) for s in self.sites)

    @property
    def main(self) -> Quantity:
        """The largest range of all sites."""
        return self.largest.quantity
