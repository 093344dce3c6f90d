"""Records of the instrument: calibrations, certificates of gauge blocks, and signed checks.

The newest change applies to the rig's next scans, unless the rig itself has a newer calibration.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import ClassVar

from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.errors import DatasetError, MeasureError, WaferViewerError
from wafer_viewer.model.gauge import Certificate, GaugeRecord
from wafer_viewer.model.spec import Spec, decode
from wafer_viewer.store.io.guarded_reading import read_content
from wafer_viewer.store.records.signed_log import append_record, read_log

CALIBRATIONS = "calibrations.jsonl"


class CalibrationChange(Spec, frozen=True, kw_only=True):
    """One line: calibration of a rig before and after a change; at: ISO 8601."""

    error: ClassVar[type[WaferViewerError]] = DatasetError
    rig: str
    at: str
    by: str
    why: str
    before: Calibration
    after: Calibration


def record_change(folder: Path, change: CalibrationChange) -> None:
    """Append a calibration that applies to the rig's next scans."""
    append_record(folder / CALIBRATIONS, change)


def calibration_changes(folder: Path, rig: str) -> tuple[CalibrationChange, ...]:
    """Return the calibration changes of a rig, oldest first. Raises DatasetError for a damaged or altered log."""
    return tuple(change for change in read_log(folder / CALIBRATIONS, CalibrationChange).records if change.rig == rig)


def calibration_in_force(folder: Path, rig: str, own: Calibration | None) -> Calibration | None:
    """Return the calibration for the next scan of a rig into a data folder; own: that of the rig itself."""
    if own is None:
        return None
    fit = [c.after for c in calibration_changes(folder, rig) if c.after.setup == own.setup and c.after.made >= own.made]
    return fit[-1] if fit else own


def read_certificate(path: Path) -> Certificate:
    """Read the calibration certificate of gauge blocks.

    Parameters
    ----------
    path : Path
        TOML file with the fields of `Certificate`, lengths in um at 20 C.

    Returns
    -------
    Certificate
        Certified step, or two blocks, with expanded uncertainty (k = 2).

    Raises
    ------
    MeasureError
        When the file cannot be read, is no valid TOML, has an unknown or invalid field, or lacks data that a check
        needs.

    References
    ----------
    .. [1] ISO 3650, Geometrical Product Specifications (GPS) - Length standards - Gauge blocks.
    .. [2] ISO 1, Geometrical product specifications (GPS) - Standard reference temperature for the specification of
       geometrical and dimensional properties.
    """
    return decode(read_content(path, MeasureError), Certificate, path.name)


GAUGE_LOG = "gauge-checks.jsonl"


def sign(folder: Path, record: GaugeRecord) -> None:
    """Append a signed check to the log of a data folder."""
    append_record(folder / GAUGE_LOG, record)


def signed_checks(folder: Path, serials: Iterable[str] = ()) -> tuple[GaugeRecord, ...]:
    """Return the signed checks of a data folder, oldest first, optionally for one set of serial numbers.

    Raises DatasetError when a line of the log is damaged, or the log was altered.
    """
    wanted = set(serials)
    records = read_log(folder / GAUGE_LOG, GaugeRecord).records
    return tuple(r for r in records if not wanted or set(r.check.certificate.serials) == wanted)
