"""Profile of a groove or a step as a small SVG: its curve, and the zones of the measurement."""

from __future__ import annotations

import numpy as np

from wafer_viewer.draw.colormaps import PROFILE_COLOURS
from wafer_viewer.draw.number_format import number
from wafer_viewer.model.measurement.step import StepProfile

WIDTH, HEIGHT = 372, 118
_TOP, _FOOT, _SIDE = 16, 16, 2
_HEADROOM = 0.08
_GAP = 3.0
"""Point distance, in multiples of the median distance, above which the curve is interrupted."""


def groove_svg(finding: StepProfile) -> str:
    """Return the profile as SVG, distance to the right, height upwards, zones as pale bands; empty without a curve."""
    if len(finding.curve) < 2:
        return ""
    at_um, z_um = np.array(finding.curve, float).T
    length_um = max(float(at_um[-1]), max((end for _, _, end in finding.zones), default=0.0), 1e-9)
    x = _SIDE + (WIDTH - 2 * _SIDE) * at_um / length_um
    low, span = float(z_um.min()), max(float(np.ptp(z_um)), 1e-9)
    y = HEIGHT - _FOOT - (HEIGHT - _TOP - _FOOT) * (_HEADROOM + (1 - 2 * _HEADROOM) * (z_um - low) / span)
    bands = "".join(_band(name, start / length_um, end / length_um) for name, start, end in finding.zones)
    return (
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" width="100%" role="img" aria-label="Profile with its zones" '
        f'font-size="11" fill="currentColor">{bands}'
        f'<path d="{_path(x, y)}" fill="none" stroke="{PROFILE_COLOURS[0]}" stroke-width="1.6" '
        'stroke-linejoin="round" stroke-linecap="round"/>'
        f'<text x="{_SIDE}" y="{HEIGHT - 3}">0</text>'
        f'<text x="{WIDTH - _SIDE}" y="{HEIGHT - 3}" text-anchor="end">{number(length_um, 1)} µm</text></svg>'
    )


def _band(name: str, start: float, end: float) -> str:
    left, right = (_SIDE + (WIDTH - 2 * _SIDE) * share for share in (start, end))
    return (
        f'<rect x="{left:.1f}" y="{_TOP}" width="{right - left:.1f}" height="{HEIGHT - _TOP - _FOOT}" opacity=".08"/>'
        f'<text x="{(left + right) / 2:.1f}" y="{_TOP - 4}" text-anchor="middle">{name}</text>'
    )


def _path(x: np.ndarray, y: np.ndarray) -> str:
    step = np.diff(x)
    apart = np.concatenate([[True], step > _GAP * float(np.median(step))])
    return "".join(
        f"{'M' if new else 'L'}{a:.1f} {b:.1f}" for new, a, b in zip(apart, x.tolist(), y.tolist(), strict=True)
    )
