"""Areal surface texture (ISO 25178-2) and profile roughness (ISO 21920-2)."""

from __future__ import annotations

from wafer_viewer.model.measurement.measurement import MeasurementResult
from wafer_viewer.model.measurement.tool_options import RoughnessOptions, TextureOptions
from wafer_viewer.model.quantity import Length, Quantity
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import Fraction, NonNegative


class Texture(MeasurementResult, frozen=True, kw_only=True, tag="texture"):
    """ISO 25178-2 parameters of a region, after removal of form and filtered wavelengths.

    Height: sa, sq, sp, sv, sz, ssk, sku. Hybrid: sdq (a slope), sdr_fraction. Functional: sk, spk, svk, smr1_fraction,
    smr2_fraction. Spatial: sal, str_ratio, std (across the lay, anticlockwise from +x). None: not defined for this
    surface; ssk, sku and sal for a flat one, std for one without a lay.
    """

    region: Region
    options: TextureOptions = TextureOptions()
    sa: Length
    sq: Length
    sp: Length
    sv: Length
    sz: Length
    ssk: float | None
    sku: float | None
    sdq: NonNegative | None = None
    sdr_fraction: NonNegative | None = None
    sk: Length | None = None
    spk: Length | None = None
    svk: Length | None = None
    smr1_fraction: Fraction | None = None
    smr2_fraction: Fraction | None = None
    sal: Length | None = None
    str_ratio: Fraction | None = None
    std: Quantity | None = None
    points: int
    measured_fraction: Fraction

    @property
    def main(self) -> Quantity:
        """Sa."""
        return self.sa.quantity


class Roughness(MeasurementResult, frozen=True, kw_only=True, tag="roughness"):
    """ISO 21920-2 parameters along a line.

    ra, rq, rt, rsk, rku: over the whole evaluation length; rp, rv, rz: means over its sections of section_um each.
    Without a cut-off the profile is the primary profile with one section, and the standard names are Pa, Pq, Pt ...
    """

    line: Region
    options: RoughnessOptions = RoughnessOptions()
    ra: Length
    rq: Length
    rz: Length
    rt: Length
    rp: Length
    rv: Length
    rsk: float | None
    rku: float | None
    sections: int
    section_um: NonNegative
    points: int
    measured_fraction: Fraction

    @property
    def main(self) -> Quantity:
        """Ra."""
        return self.ra.quantity
