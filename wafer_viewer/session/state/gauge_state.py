"""The gauge-block check as the snapshot shows it."""

from __future__ import annotations

from dataclasses import dataclass

from wafer_viewer.model.gauge.gauge_check import (
    Certificate,
    GaugeCheck,
    GaugeRecord,
    GaugeRepeat,
    GaugeTerms,
    ScaleCorrection,
)
from wafer_viewer.model.gauge.run_chart import Capability, RunChart
from wafer_viewer.model.region import Region

Faces = tuple[Region, Region]
"""The upper and the lower face."""


@dataclass(frozen=True, slots=True)
class Tick:
    """A point of the preparation that somebody says is done: ``clean``, ``warm``; at: ISO 8601."""

    point: str
    at: str


@dataclass(frozen=True, slots=True)
class GaugeState:
    """A running check: its certificate and terms, the repeats taken, what they come to, what was signed before.

    refusal: why the open dataset can be no repeat now, one sentence, or None. faces: those of the last repeat. check:
    the result of the repeats so far, not signed; None as long as there is none. records: signed checks of these very
    blocks, oldest first; chart and capability are of them. correction: what `correct_scale` would write, after a
    signed check. busy: a repeat is being measured.
    """

    certificate: Certificate | None = None
    terms: GaugeTerms = GaugeTerms()
    ticks: tuple[Tick, ...] = ()
    refusal: str | None = None
    faces: Faces | None = None
    repeats: tuple[GaugeRepeat, ...] = ()
    check: GaugeCheck | None = None
    signed: GaugeCheck | None = None
    records: tuple[GaugeRecord, ...] = ()
    chart: RunChart | None = None
    capability: Capability | None = None
    correction: ScaleCorrection | None = None
    busy: bool = False
