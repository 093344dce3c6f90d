"""Certificates of gauge blocks: TOML files, with one sentence per error."""

from __future__ import annotations

from pathlib import Path

from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.gauge.gauge_check import Certificate
from wafer_viewer.model.spec import decode


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
    try:
        text = path.read_bytes()
    except OSError as fault:
        raise MeasureError(f"The certificate {path} cannot be read: {fault.strerror}.") from fault
    return decode(text, Certificate, path.name)
