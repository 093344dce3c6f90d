"""HTML of texture and roughness parameters, by the families of ISO 25178-2."""

from __future__ import annotations

import math
from collections.abc import Sequence

from wafer_viewer.draw.number_format import NOTHING, number, share, with_unit
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.measurement.texture import Roughness, Texture
from wafer_viewer.model.quantity import Length

Cells = Sequence[tuple[str, str]]
COLUMNS = 3
FIGURES, MOST_DECIMALS = 3, 4
"""Significant digits of a texture height, and the largest number of decimals."""

MEANINGS = {
    "Sa": "Arithmetical mean height",
    "Sq": "Root mean square height",
    "Sz": "Highest peak over lowest pit",
    "Sp": "Highest peak over the mean",
    "Sv": "Lowest pit under the mean",
    "Ssk": "Skewness: over 0 peaks, under 0 valleys prevail",
    "Sku": "Kurtosis: 3 for normal heights",
    "Sdq": "Root mean square slope",
    "Sdr": "How much larger the surface is than its projection",
    "Sk": "Height of the core",
    "Spk": "Reduced height of the peaks over the core",
    "Svk": "Reduced depth of the valleys under the core",
    "Smr1": "Material ratio where peaks end",
    "Smr2": "Material ratio where valleys begin",
    "Sal": "Autocorrelation length: the shortest distance at which heights no longer correlate",
    "Str": "Texture aspect ratio: near 1 isotropic, near 0 with a lay",
    "Std": "Texture direction, across the lay, counter-clockwise from x",
    "Ra": "Arithmetical mean height of the whole evaluation length",
    "Rq": "Root mean square height of the whole evaluation length",
    "Rt": "Highest over lowest of the whole evaluation length",
    "Rsk": "Skewness: over 0 peaks, under 0 valleys prevail",
    "Rku": "Kurtosis: 3 for normal heights",
    "Rz": "Highest over lowest, mean of the sections",
    "Rp": "Highest peak, mean of the sections",
    "Rv": "Lowest pit, mean of the sections",
}
"""Tooltips of the parameters."""


def texture(finding: Texture) -> str:
    """Return all texture parameters by family, and the measured fraction."""
    families: list[tuple[str, Cells]] = [
        ("Height", (("Sa", _um(finding.sa)), ("Sq", _um(finding.sq)), ("Sz", _um(finding.sz)))),
        ("", (("Sp", _um(finding.sp)), ("Sv", _um(finding.sv)))),
        ("", (("Ssk", number(finding.ssk, 2, signed=True)), ("Sku", number(finding.sku, 2)))),
        ("Hybrid", (("Sdq", figures(finding.sdq)), ("Sdr", _percent(finding.sdr_fraction)))),
        ("Functional", (("Sk", _um(finding.sk)), ("Spk", _um(finding.spk)), ("Svk", _um(finding.svk)))),
        ("", (("Smr1", _percent(finding.smr1_fraction)), ("Smr2", _percent(finding.smr2_fraction)))),
        ("Spatial", (("Sal", _um(finding.sal)), ("Str", number(finding.str_ratio, 2)), ("Std", _std(finding)))),
    ]
    return _table(families) + _measured(finding)


def roughness(finding: Roughness) -> str:
    """Return all roughness parameters, the sampling lengths, and the measured fraction."""
    families: list[tuple[str, Cells]] = [
        ("Evaluation", (("Ra", _um(finding.ra)), ("Rq", _um(finding.rq)), ("Rt", _um(finding.rt)))),
        ("", (("Rsk", number(finding.rsk, 2, signed=True)), ("Rku", number(finding.rku, 2)))),
        ("Sections", (("Rz", _um(finding.rz)), ("Rp", _um(finding.rp)), ("Rv", _um(finding.rv)))),
    ]
    each = f"{finding.sections} × {with_unit(finding.section_um, 1)}"
    return _table(families) + _measured(finding, ("Sampling lengths", each))


def figures(value: float | None) -> str:
    """Format a number to three significant digits, with at most four decimals."""
    if value is None or not math.isfinite(value) or value == 0:
        return number(value, 2)
    digits = FIGURES - 1 - math.floor(math.log10(abs(value)))
    return number(value, min(MOST_DECIMALS, max(0, digits)))


def _table(families: Sequence[tuple[str, Cells]]) -> str:
    rows = [html.row([html.safe(family), *_padded(cells)]) for family, cells in families]
    return html.table([], rows)


def _padded(cells: Cells) -> list[str]:
    """Return the cells of a row, padded to `COLUMNS` so that all row lines have one length."""
    return [*(_cell(*cell) for cell in cells), *[""] * (COLUMNS - len(cells))]


def _cell(name: str, value: str) -> str:
    shown = f'<span class="wv-lab">{html.safe(name)}</span> <b style="font-weight:550">{html.safe(value)}</b>'
    return f'<span title="{html.safe(MEANINGS.get(name, ""))}">{shown}</span>'


def _measured(finding: Texture | Roughness, *more: tuple[str, str]) -> str:
    return html.pairs([*more, ("Points", number(finding.points, 0)), ("Measured", share(finding.measured_fraction))])


def _um(length: Length | None) -> str:
    return NOTHING if length is None else figures(length.value_um)


def _percent(fraction: float | None) -> str:
    return NOTHING if fraction is None else f"{figures(100 * fraction)}\u202f%"


def _std(finding: Texture) -> str:
    return NOTHING if finding.std is None else f"{number(finding.std.value, 1)}°"
