"""Calibrations from signed checks, and the list of characteristics with their dates."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.acquisition.characteristics import (
    KINDS,
    NOT_MEASURED,
    CalibrationKind,
    CalibrationRecord,
    CalibrationResult,
    Characteristic,
)
from wafer_viewer.model.gauge import GaugeRecord
from wafer_viewer.session.core.dataset_library import today
from wafer_viewer.session.gauge.z_scale_correction import z_scale_result
from wafer_viewer.store.records.calibration_records import calibration_records


@dataclass(frozen=True, slots=True)
class CalibrationRow:
    """Row of the list of calibrations: a kind and its newest record; None if there is none."""

    kind: CalibrationKind
    title: str
    needs: str
    record: CalibrationRecord | None
    is_due: bool


def calibration_rows(folder: Path, rig: str | None = None) -> tuple[CalibrationRow, ...]:
    """Return a row for each kind of calibration with its newest record in a data folder.

    Raises DatasetError when a record is damaged.
    """
    newest = {record.result.kind: record for record in calibration_records(folder, rig)}
    day = today()
    return tuple(
        CalibrationRow(kind, one.title, one.needs, newest.get(kind), kind not in newest or newest[kind].is_due(day))
        for kind, one in KINDS.items()
    )


def linearity_result(records: Iterable[GaugeRecord]) -> CalibrationResult:
    """Return amplification and linearity of z from signed checks against gauge blocks.

    Each pair of blocks counts by its newest check with an uncertainty. Raises MeasureError without one.
    """
    from wafer_viewer.calibrate.pixel_scale import Estimate
    from wafer_viewer.calibrate.topography import StepPair, scale_response

    newest = {r.check.certificate.serials: r.check for r in records if r.check.deviation.expanded_um is not None}
    steps = [
        StepPair(
            Estimate(check.height.value_um, (check.deviation.expanded_um or 0.0) / 2),
            Estimate(check.reference.value_um, 0.0),
        )
        for check in newest.values()
    ]
    found = scale_response(steps)
    standard = "ISO 25178-600:2019"
    lines = [
        Characteristic(
            name="amplification coefficient of z",
            value=found.amplification.value,
            unit="1",
            expanded=2 * found.amplification.u,
            standard=standard,
        )
    ]
    notes = [f"From {len(steps)} certified step{'' if len(steps) == 1 else 's'}; U is that of the checks."]
    sets: dict[str, float | str | tuple[str, ...]] = {}
    if found.linearity_um is None:
        notes.append("The linearity deviation is not measured: it takes certified steps of two heights at least.")
    else:
        deviation, u = found.linearity_um.value, found.linearity_um.u
        lines.append(
            Characteristic(
                name="linearity deviation of z", value=deviation, unit="um", expanded=2 * u, standard=standard
            )
        )
        sets["u_z_linearity_um"] = (deviation**2 / 3 + u**2) ** 0.5
    return CalibrationResult(kind="linearity", characteristics=tuple(lines), sets=sets, notes=tuple(notes))


FROM_CHECKS: dict[CalibrationKind, Callable[[Sequence[GaugeRecord], Calibration], CalibrationResult]] = {
    "z": z_scale_result,
    "linearity": lambda checks, _: linearity_result(checks),
}
"""Evaluation of the signed checks of a rig, oldest first, under its calibration in force, by kind."""


def not_measured() -> tuple[tuple[str, str], ...]:
    """Return the characteristics that no calibration here measures, and what they need."""
    return tuple(NOT_MEASURED.items())
