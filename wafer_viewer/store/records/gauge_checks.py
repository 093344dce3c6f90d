"""``gauge-checks.jsonl`` in the data folder: one line for each signed check against gauge blocks."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from wafer_viewer.model.gauge.gauge_check import GaugeRecord
from wafer_viewer.store.io.jsonl_log import append_line, read_lines

GAUGE_LOG = "gauge-checks.jsonl"


def sign(folder: Path, record: GaugeRecord) -> None:
    """Append a signed check to the log of a data folder."""
    append_line(folder / GAUGE_LOG, record)


def signed_checks(folder: Path, serials: Iterable[str] = ()) -> tuple[GaugeRecord, ...]:
    """Return the signed checks of a data folder, oldest first, optionally for one set of serial numbers.

    Raises DatasetError when a line of the log is damaged.
    """
    wanted = set(serials)
    records = read_lines(folder / GAUGE_LOG, GaugeRecord)
    return tuple(r for r in records if not wanted or set(r.check.certificate.serials) == wanted)
