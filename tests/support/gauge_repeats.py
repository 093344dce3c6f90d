"""Repeats and certificates with round numbers, of which checks can be computed by hand."""

from __future__ import annotations

import datetime

from tests.support.surfaces import calibration
from wafer_viewer.measure.gauge.gauge_check import gauge_check
from wafer_viewer.model.gauge import Certificate, GaugeCheck, GaugeRecord, GaugeRepeat, GaugeTerms
from wafer_viewer.model.quantity import Contribution, Length
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace

UPPER, LOWER = Region.rectangle(-150, -50, -10, 50), Region.rectangle(10, -50, 150, 50)
CALIBRATION = calibration(u_z_scale=2e-4)
STEP_UM = 400.0


def certificate(**changes) -> Certificate:
    facts = {
        "number": "C1",
        "laboratory": "Lab",
        "issued": datetime.date(2026, 1, 1),
        "expires": datetime.date(2026, 12, 31),
        "nominal_um": STEP_UM,
        "value_um": STEP_UM,
        "expanded_um": 0.06,
        "serial_numbers": ("A1", "A2"),
    }
    return Certificate(**{**facts, **changes})


def repeat(value_um: float, n: int = 0, noise_um: float = 0.04, calibration=CALIBRATION, **changes) -> GaugeRepeat:
    """One scan: z scale 0.08 um of 400 um, noise as given."""
    scale_um = 0.0 if calibration is None else calibration.u_z_scale * STEP_UM
    lines = {"noise and form of the faces": noise_um, "z scale": scale_um}
    height = Length.evaluated(value_um, tuple(Contribution(name=k, u_um=u) for k, u in lines.items()))
    facts = {"dataset": f"scan-{n}", "taken": "2026-06-01T10:00:00", "surface": f"mark-{n}", "height": height}
    return GaugeRepeat(**{"upper": UPPER, "lower": LOWER, "calibration": calibration, **facts, **changes})


def repeats(*values_um: float, **changes) -> tuple[GaugeRepeat, ...]:
    return tuple(repeat(value_um, n, **changes) for n, value_um in enumerate(values_um))


def signed(day: str, *values_um: float, terms=GaugeTerms(limit_um=0.5), **changes) -> GaugeCheck:
    found = gauge_check(repeats(*values_um, **changes), certificate(), terms)
    return replace(found, at=f"{day}T12:00:00.000+00:00", signed_by="Ann")


def record(*args, **kwargs) -> GaugeRecord:
    return GaugeRecord(check=signed(*args, **kwargs), rig="Rig 1", result="default", software_version="test")
