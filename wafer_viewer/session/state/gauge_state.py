"""Gauge-block check, as in the snapshot."""

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
"""Upper and lower face."""


@dataclass(frozen=True, slots=True)
class Tick:
    """Preparation step marked as done: ``clean``, ``warm``; at: ISO 8601."""

    point: str
    at: str


@dataclass(frozen=True, slots=True)
class GaugeState:
    """Running check: its certificate and terms, the repeats, their evaluation, and earlier signed checks.

    refusal: why the open dataset cannot be a repeat now, one sentence, or None. faces: those of the last repeat. check:
    the evaluation of the repeats so far, unsigned; None while there are none. records: signed checks of these very
    blocks, oldest first, from which chart and capability are computed. correction: what `correct_scale` would write,
    after a signed check. busy: a repeat is being measured.
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
