"""Certificates of gauge blocks: TOML files that are refused in one sentence."""

from __future__ import annotations

from pathlib import Path

from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.gauge.gauge_check import Certificate
from wafer_viewer.model.spec import decode


def read_certificate(path: Path) -> Certificate:
    """The certificate in a file. Raises MeasureError when it cannot be read or lacks what a check needs."""
    try:
        text = path.read_bytes()
    except OSError as fault:
        raise MeasureError(f"The certificate {path} cannot be read: {fault.strerror}.") from fault
    return decode(text, Certificate, path.name)
