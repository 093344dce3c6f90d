"""What was measured: numbers with their uncertainty, and what they were measured on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.spec import NonNegative, Spec

UStatus = Literal["evaluated", "not evaluated", "uncalibrated"]


class Contribution(Spec, frozen=True, kw_only=True):
    """One line of an uncertainty budget, standard uncertainty (k = 1) in um."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    name: str
    u_um: NonNegative


class Length(Spec, frozen=True, kw_only=True):
    """A length in um with its expanded uncertainty (k = 2), or the word that says why there is none."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    value_um: float
    expanded_um: NonNegative | None = None
    status: UStatus = "not evaluated"
    budget: tuple[Contribution, ...] = ()

    @classmethod
    def evaluated(cls, value_um: float, budget: tuple[Contribution, ...]) -> Length:
        """A length whose uncertainty is the root sum of squares of a budget, times two."""
        u = float(np.sqrt(sum(c.u_um**2 for c in budget)))
        return cls(value_um=value_um, expanded_um=2 * u, status="evaluated", budget=budget)


class Finding(Spec, frozen=True, kw_only=True):
    """What every result carries: a name, the map and filter it was measured on, and whether any of it is simulated."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    name: str = ""
    number: int = 0
    surface: Literal["unsmoothed", "smoothed", "filled"] = "unsmoothed"
    filter: str = "none"
    simulated: bool = False
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class ProfileCurve:
    """The points of a profile: distance_um and z_um, float64 [n]; NaN where the surface is unmeasured."""

    distance_um: NDArray[np.float64]
    z_um: NDArray[np.float64]
    x_um: NDArray[np.float64]
    y_um: NDArray[np.float64]


class Profile(Finding, frozen=True, kw_only=True, tag="profile"):
    """A section along a line: its total height Pt and the rise from its first to its last measured point."""

    line: Region
    length_um: NonNegative
    pt: Length
    rise: Length
    measured_fraction: NonNegative


class StepHeight(Finding, frozen=True, kw_only=True, tag="step_height"):
    """The height of one region over another, fitted with a common plane; the definition of h is part of the result."""

    upper: Region
    lower: Region
    height: Length
    definition: str
    upper_mean_um: float
    lower_mean_um: float
    upper_sq_um: NonNegative
    lower_sq_um: NonNegative
    upper_points: int
    lower_points: int
    relative_tilt_mrad: NonNegative = 0.0


class Flatness(Finding, frozen=True, kw_only=True, tag="flatness"):
    """Flatness of a region, ISO 12781: FLTt and FLTq about a reference plane."""

    region: Region
    reference: Literal["least_squares", "minimum_zone"]
    flt_t: Length
    flt_q: Length
    band_9973_um: NonNegative = 0.0


class GaugeCheck(Finding, frozen=True, kw_only=True, tag="gauge_check"):
    """A step against certified gauge blocks: deviation, En, and the verdict by the guard band of ISO 14253-1."""

    step: StepHeight
    certified: Length
    serial_numbers: str
    deviation_um: float
    limit_um: NonNegative
    en: float | None
    verdict: Literal["pass", "fail", "inconclusive", "no verdict"]


class Defect(Finding, frozen=True, kw_only=True, tag="defect"):
    """A place that differs from its reference: where, how large, what class, how it was judged."""

    center: Point
    outline: Region
    kind: str
    diameter: Length
    height: Length
    area_um2: NonNegative
    score: float
    judgement: Literal["open", "real", "nuisance"] = "open"


AnyFinding = Profile | StepHeight | Flatness | GaugeCheck | Defect


class Findings(Spec, frozen=True, kw_only=True):
    """The list of results of one reconstruction: the file ``findings.json``."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    items: tuple[AnyFinding, ...] = ()
