"""Proposed correction of the z scale from gauge blocks; it is never applied automatically."""

from __future__ import annotations

import datetime

from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.gauge import GaugeCheck, ScaleCorrection
from wafer_viewer.model.spec import replace

LEAST_REPEATS = 3
"""Fewest repeats for a correction of the scale."""


def scale_correction(check: GaugeCheck, in_force: Calibration, today: str) -> ScaleCorrection:
    """Return the calibration with which the mean of a check's repeats equals the certified value.

    in_force: current calibration of the rig, of which only the z scale changes; today: ISO 8601. The uncertainty of the
    scale is that of the comparison. It is due after the check's interval, but not later than the calibration it
    replaces. Raises MeasureError with fewer than three repeats, without an uncertainty, for another optical setup, and
    if the current scale is more certain than the check and consistent with it.
    """
    used = _require_fit(check, in_force)
    reference_um, u_um = check.reference.value_um, (check.deviation.expanded_um or 0.0) / 2
    factor = reference_um / check.height.value_um
    due = datetime.date.fromisoformat(today) + datetime.timedelta(days=check.terms.interval_days)
    corrected = replace(
        in_force,
        z_scale=used.z_scale * factor,
        u_z_scale=u_um / reference_um,
        z_against=check.certificate.serials,
        made=today,
        due=min(due.isoformat(), in_force.due),
    )
    changes_um = reference_um - check.height.value_um
    return ScaleCorrection(
        calibration=corrected, factor=factor, changes_um=changes_um, advice=_advice(check, used, corrected)
    )


def _require_fit(check: GaugeCheck, in_force: Calibration) -> Calibration:
    """Return the calibration used for the repeats; raise MeasureError if the check cannot set the scale."""
    if check.n < LEAST_REPEATS:
        raise MeasureError(
            f"The check has {check.n} repeat{'' if check.n == 1 else 's'} and the z scale is set by {LEAST_REPEATS} "
            "at least: scan the blocks again."
        )
    used = check.repeats[0].calibration
    if used is None or check.deviation.expanded_um is None:
        raise MeasureError("The check has no uncertainty: the z scale cannot be set by it.")
    if used.setup != in_force.setup:
        raise MeasureError(
            f"The check is of {used.setup.objective or 'another objective'} and the rig has "
            f"{in_force.setup.objective or 'another'}: check it as it is now."
        )
    return used


def _advice(check: GaugeCheck, before: Calibration, after: Calibration) -> str:
    error_um, expanded_um = check.deviation.value_um, check.deviation.expanded_um or 0.0
    if abs(error_um) > expanded_um:
        return f"The error of {error_um:+.3f} um is more than its U of {expanded_um:.2g} um: the scale is off."
    if after.u_z_scale >= before.u_z_scale:
        raise MeasureError(
            f"The error of {error_um:+.3f} um is within its U of {expanded_um:.2g} um and the z scale is known better "
            "than that: there is nothing to correct."
        )
    return (
        f"The error is within its U of {expanded_um:.2g} um, so the scale may be right as it is; "
        f"set by the blocks, its u would be {after.u_z_scale:.2g} in place of {before.u_z_scale:.2g}."
    )
