"""Signed checks of a data folder that are what they say: read from a log that nobody altered, and not contradicting."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.gauge import GaugeRecord


def trusted_checks(folder: Path, serials: Iterable[str] = ()) -> tuple[GaugeRecord, ...]:
    """Return the signed checks of a data folder, oldest first, optionally for one set of serial numbers.

    Raises DatasetError when the log is damaged or was altered, or a check contradicts its own numbers.
    """
    from wafer_viewer.measure.gauge.gauge_check import contradiction
    from wafer_viewer.store.records.gauge_records import GAUGE_LOG, signed_checks

    records = signed_checks(folder, serials)
    for record in records:
        if (fault := contradiction(record.check)) is not None:
            which = f"the check of {record.check.at} by {record.check.signed_by}"
            raise DatasetError(f"{folder / GAUGE_LOG}: {which} was altered: {fault}. Restore the log from a copy.")
    return records
