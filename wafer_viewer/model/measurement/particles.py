"""Particles and grains of a face: options, one particle, and the result with the table of all."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.measurement.measurements import MEASURED, MeasurementResult
from wafer_viewer.model.measurement.result_rows import UNLISTED, Label
from wafer_viewer.model.measurement.tool_options import OptionsSpec
from wafer_viewer.model.quantity import Length
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.spec import Fraction, NonNegative, Positive, Spec


class ParticleOptions(OptionsSpec, frozen=True, kw_only=True):
    """Options of the particles.

    stand: above or below the plane of the face. over_um: height over (depth under) it from which a place belongs to a
    particle; None: six robust deviations of the face. split: parts that touch are one, or grains by their own tops.
    least_um: equivalent diameter below which a particle is left out; None: the focus window.
    """

    stand: Literal["above", "below"] = "above"
    over_um: Positive | None = None
    split: Literal["none", "tops"] = "none"
    least_um: NonNegative | None = None


class Particle(Spec, frozen=True, kw_only=True):
    """One particle: centre, equivalent diameter, longest and shortest extent, height, area, volume, circularity."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    place: Point
    diameter_um: NonNegative
    longest_um: NonNegative
    shortest_um: NonNegative
    height_um: NonNegative
    area_um2: NonNegative
    volume_um3: NonNegative
    circularity: NonNegative


class Particles(MeasurementResult, frozen=True, kw_only=True, tag="particles"):
    """Particles or grains that stand out of the plane of a face, the largest first.

    mean_diameter: of circles of their areas. n_cut: those cut by the region or beside unmeasured places, which the
    table, mean and density leave out. covered_fraction: share of the measured area that all of them cover.
    """

    main_fields: ClassVar[tuple[str, ...]] = ("mean_diameter",)
    region: Region
    options: ParticleOptions = ParticleOptions()
    mean_diameter: Annotated[Length, Label("Mean diameter")]
    median_diameter: Annotated[Length, Label("Median diameter")]
    mean_height: Annotated[Length, Label("Mean height of the particles")]
    n_particles: Annotated[int, Label("Particles")]
    n_cut: Annotated[int, Label("Left out, cut or not measured")]
    density_per_mm2: Annotated[NonNegative, Label("Particles per mm²", digits=0)]
    covered_fraction: Annotated[Fraction, Label("Share covered")]
    threshold_um: Annotated[NonNegative, Label("Threshold over the plane")]
    measured_fraction: Annotated[Fraction, MEASURED]
    particles: Annotated[tuple[Particle, ...], UNLISTED] = ()
