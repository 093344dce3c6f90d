"""Options of the measuring tools: one spec per tool, whose fields are keywords of its measuring function."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.measurement.result_rows import Label
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.spec import NonNegative, Positive, Spec, Within

# ------------------------------------------------------------------------------------------------------------ levelling


LevelBy = Literal["stage", "three points", "plane", "region", "form"]
PLACES: dict[LevelBy, int] = {"stage": 0, "three points": 3, "plane": 0, "region": 1, "form": 0}
"""Number of regions for each levelling method; `plane` and `form` are fitted to the whole surface."""


class Levelling(Spec, frozen=True, kw_only=True):
    """Levelling method and its regions (points, or the region whose plane is zero).

    order: of the polynomial, only for `form`.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    by: LevelBy = "stage"
    places: tuple[Region, ...] = ()
    order: Annotated[int, Within(1, 4)] = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.places) != PLACES[self.by]:
            self.refuse("places", f"{PLACES[self.by]} places to level by {self.by}")


class Datum(Spec, frozen=True, kw_only=True):
    """Zero surface: z = sum of c_ij u^i v^j, u = x - center x and v = y - center y, all in um.

    powers: the exponents (i, j) of each coefficient; no coefficients mean the zero of the stage.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    center: Point = Point(x_um=0.0, y_um=0.0)
    powers: tuple[tuple[int, int], ...] = ()
    coefficients: tuple[float, ...] = ()

    def at(self, x_um: NDArray[np.float64], y_um: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return its height at positions (arrays that broadcast together) in um."""
        u, v = np.asarray(x_um, float) - self.center.x_um, np.asarray(y_um, float) - self.center.y_um
        zero = np.zeros(np.broadcast_shapes(u.shape, v.shape))
        return sum((c * u**i * v**j for (i, j), c in zip(self.powers, self.coefficients, strict=True)), zero)


# --------------------------------------------------------------------------------------------------------- tool options


STEEL_PER_K = 11.5e-6
"""Thermal expansion of steel gauge blocks, relative per kelvin (ISO 3650)."""


class Conditions(Spec, frozen=True, kw_only=True):
    """Standard uncertainties (k = 1) of a step height by cause; None: unknown, and listed as not evaluated.

    repeatability_um: standard deviation of the height over repeat scans; drift_um: of z between the two faces during
    the scan; z_linearity_um: error of the z axis over the step besides its scale; abbe_um: pitch of the stage times the
    offset of the sample from the axis of its scale; temperature_c, u_temperature_c: of the sample; expansion_per_k: of
    its material, relative.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    repeatability_um: NonNegative | None = None
    drift_um: NonNegative | None = None
    z_linearity_um: NonNegative | None = None
    abbe_um: NonNegative | None = None
    temperature_c: float | None = None
    u_temperature_c: Annotated[NonNegative, Label("Uncertainty of temperature")] = 0.5
    expansion_per_k: Annotated[NonNegative, Label("Thermal expansion per K")] = STEEL_PER_K


class OptionsSpec(Spec, frozen=True, kw_only=True):
    """Base class of all tool options."""

    error: ClassVar[type[WaferViewerError]] = MeasureError


StepDefinition = Literal["common_plane", "upper_face", "lower_face", "joint"]
"""Position at which the faces of a step are compared.

The middle of each region, over a common plane or the plane of one of them; or the middle between the regions, to which
both are extrapolated.
"""


class StepOptions(OptionsSpec, frozen=True, kw_only=True):
    """Options of the step height: its definition, and the conditions of the measurement."""

    definition: StepDefinition = "common_plane"
    conditions: Conditions = Conditions()


class GrooveOptions(OptionsSpec, frozen=True, kw_only=True):
    """Options of the groove tool. shape: a groove (or a ridge) with two edges, or a single step."""

    shape: Literal["groove", "step"] = "groove"
    conditions: Conditions = Conditions()


class VolumeOptions(OptionsSpec, frozen=True, kw_only=True):
    """Options of the volume tool.

    reference: plane through the border of the region, or the zero of heights; None: the border if heights are read from
    the zero of the stage, else the chosen zero.
    """

    reference: Literal["border", "zero"] | None = None


SlopeScheme = Literal["neighbours", "seven_point"]
Borders = Literal["keep", "cut"]
"""Evaluation of the border of a filtered region or line, half the longest filter wide."""
Spikes = Literal["keep", "remove"]


class TextureOptions(OptionsSpec, frozen=True, kw_only=True):
    """Options of the areal texture.

    form_order: order of the least-squares polynomial removed as form; 0 is the mean, 1 a plane.
    s_filter_um, l_filter_um: nesting indices of the Gaussian filters of ISO 16610-61 that remove shorter and longer
    wavelengths; None: no filter. noise_um: root mean square noise of the heights, as `calibrate noise` measures it, for
    the uncertainty; None: that of the heights' own uncertainty. slopes: how Sdq and Sdr take slopes, of neighbouring or
    of seven pixels. borders: what a filter evaluates over less than its length. spikes: single heights far from their
    neighbours. c_um: height over the mean of Smr(c),
    mr_percent: material ratio of Smc; None: not given.
    """

    form_order: Annotated[int, Within(0, 8)] = 1
    s_filter_um: Positive | None = None
    l_filter_um: Positive | None = None
    noise_um: NonNegative | None = None
    slopes: SlopeScheme = "neighbours"
    borders: Annotated[Borders, Label("Filter at borders")] = "keep"
    spikes: Spikes = "keep"
    c_um: Annotated[float | None, Label("c of Smr(c)")] = None
    mr_percent: Annotated[Annotated[float, Within(0, 100)] | None, Label("Material ratio of Smc, %")] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.s_filter_um is not None and self.l_filter_um is not None and self.s_filter_um >= self.l_filter_um:
            self.refuse("s_filter_um", f"under l_filter_um, which is {self.l_filter_um:g}: else nothing is left")


class RoughnessOptions(OptionsSpec, frozen=True, kw_only=True):
    """Options of the profile roughness.

    lambda_c_um, lambda_s_um: cut-offs of the Gaussian filters of ISO 16610-21 that remove longer and shorter
    wavelengths; None: no filter. noise_um, borders: as those of the areal texture.
    """

    lambda_c_um: Positive | None = None
    lambda_s_um: Positive | None = None
    noise_um: NonNegative | None = None
    borders: Annotated[Borders, Label("Filter at borders")] = "keep"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.lambda_s_um is not None and self.lambda_c_um is not None and self.lambda_s_um >= self.lambda_c_um:
            self.refuse("lambda_s_um", f"under lambda_c_um, which is {self.lambda_c_um:g}: else nothing is left")


class KerfOptions(OptionsSpec, frozen=True, kw_only=True):
    """Options of the kerf width. kerf: brighter or darker in the picture than its surroundings."""

    kerf: Literal["either", "bright", "dark"] = "either"


class DieOptions(OptionsSpec, frozen=True, kw_only=True):
    """Options of the die size. die: its rim is brighter or darker in the picture than its surroundings."""

    die: Literal["either", "bright", "dark"] = "either"


class CircleOptions(OptionsSpec, frozen=True, kw_only=True):
    """Options of the circle. inside: the picture is brighter or darker inside the edge."""

    inside: Literal["either", "bright", "dark"] = "either"


class ChippingOptions(OptionsSpec, frozen=True, kw_only=True):
    """Options of chipping. limit_um: depth above which a deviation is a chip.

    None: four robust standard deviations of the edge, at least two pixels. die: the brighter or darker side of the
    edge; auto: the higher side.
    """

    limit_um: Positive | None = None
    die: Literal["auto", "bright", "dark"] = "auto"


class CoplanarityOptions(OptionsSpec, frozen=True, kw_only=True):
    """Options of coplanarity. reference: the least-squares plane of the tops, or the seating plane."""

    reference: Literal["least_squares", "seating"] = "least_squares"


class SiteRangeOptions(OptionsSpec, frozen=True, kw_only=True):
    """Options of the site range. width_um, height_um: of a site; None: a quarter of the region's side."""

    width_um: Positive | None = None
    height_um: Positive | None = None
