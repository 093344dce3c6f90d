"""A matrix of heights as text, one line a row from the top edge down, with sizes and units in header lines.

Headers of Gwyddion, ESRI grids, Keyence and others are searched for names and numbers, not parsed: what they do not
say with its unit is asked for.
"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.store.formats.reader_support import (
    UNITS_UM,
    ReadOptions,
    heights_only,
    on_square_pixels,
    provenance_of,
    scaled,
)
from wafer_viewer.store.formats.text_lines import TextLayout

_FACT = re.compile(
    r"([^\W\d][^\d:=,;\t]*?)\s*[:=,;\t\s]\s*([-+]?\d*\.?\d+(?:e[-+]?\d+)?)(?![\w.]|[-/:]\d)[\s,;(\[]*([a-zµμ]+)?", re.I
)
"""Name, number and unit."""
_Z_UNIT = re.compile(r"(?:(?:value|data|height|z)[ -]?)?units?\s*[:=,;\t]\s*([a-zµμ]+)", re.I)
_UNIT_OF_NAME = re.compile(r"\s*[\[( ](nm|um|µm|μm|mm)[\])]?$", re.I)
_PIXEL = (
    *("pixel size", "pixelsize", "pixel pitch", "pixel", "xy calibration", "lateral resolution", "cellsize", "pitch"),
    *("lateral spacing", "grid spacing", "spacing", "sampling"),
)
_PIXEL_X = (
    "x pixel size",
    "pixel size x",
    "pixel width",
    "dx",
    "x step",
    "step x",
    "x spacing",
    "spacing x",
    "x pitch",
)
_PIXEL_Y = (
    "y pixel size",
    "pixel size y",
    "pixel height",
    "dy",
    "y step",
    "step y",
    "y spacing",
    "spacing y",
    "y pitch",
)
_WIDTH = ("width", "breite", "x size", "size x", "x range", "x length", "length x", "x-length", "xreal")
_HEIGHT = ("height", "höhe", "y size", "size y", "y range", "y length", "length y", "y-length", "yreal")
_COLUMNS = ("ncols", "cols", "columns", "n cols", "x pixels", "pixels x", "horizontal", "w")
_ROWS = ("nrows", "rows", "lines", "n rows", "y pixels", "pixels y", "vertical", "h")
_NO_DATA = ("nodata value", "nodata", "no data", "no data value", "bad pixel value", "invalid value", "missing value")
Facts = dict[str, tuple[float, str]]


def states_matrix(layout: TextLayout) -> bool:
    """Return whether header lines state width and height, or as many columns as there are."""
    facts = _facts(layout)
    has_sizes = _length_um(facts, _WIDTH) is not None and _length_um(facts, _HEIGHT) is not None
    return has_sizes or (_find(facts, _COLUMNS) or (0.0, ""))[0] == layout.n_columns


def read_matrix(layout: TextLayout, options: ReadOptions) -> HeightMap:
    """Read a matrix of heights. Raises DatasetError if its rows differ in length, or its pixel size is not known."""
    lines = [line.replace('"', "") for line in layout.comments]
    if any("wyko ascii" in line.lower() for line in lines):
        raise options.refuse("is a Wyko ASCII file, whose values have another order: save it as OPD.")
    options.require_heights_up(next((line for line in lines if line.lower().startswith("depth")), ""))
    facts = _facts(layout)
    raw = np.concatenate(list(layout.blocks(None, options)))
    _require_heights_alone(raw, facts, options)
    z_scale = options.z_scale_um(next((match[1] for line in lines if (match := _Z_UNIT.match(line))), None))
    pitches_um = options.pitches_um(*_pitches_um(facts, raw.shape))
    if (stated := _find(facts, _NO_DATA)) is not None:
        raw[raw == stated[0]] = np.nan
    remove_sentinels(options, raw)
    z_um, pixel_um = on_square_pixels(options, scaled(options, raw, z_scale), *pitches_um)
    options.notes.append(f"It was read as {raw.shape[0]} rows of {raw.shape[1]} heights, the first line on top.")
    return heights_only(options, z_um, pixel_um, 0.0, 0.0, provenance_of(None, None, *lines))


def _facts(layout: TextLayout) -> Facts:
    """Return numbers of the header by their names in lower case, each with its unit or an empty text."""
    facts: Facts = {}
    for line in layout.comments:
        text = line.replace('"', "")
        text = re.sub(r"(\d),(\d)", r"\1.\2", text) if layout.has_decimal_comma else text
        for name, number, unit in _FACT.findall(text):
            name = " ".join(name.lower().replace("_", " ").split())
            in_name = _UNIT_OF_NAME.search(name)
            key = name[: in_name.start()] if in_name else name
            facts.setdefault(key, (float(number), in_name[1] if in_name else unit))
    return facts


def _find(facts: Facts, names: tuple[str, ...]) -> tuple[float, str] | None:
    return next((facts[name] for name in names if name in facts), None)


def _length_um(facts: Facts, names: tuple[str, ...]) -> float | None:
    """Return a length in um; None if the header does not state it with its unit."""
    value, unit = _find(facts, names) or (0.0, "")
    factor = UNITS_UM.get(unit) or UNITS_UM.get(unit.lower())
    return value * factor if factor is not None and value > 0 else None


def _pitches_um(facts: Facts, shape: tuple[int, ...]) -> tuple[float | None, float | None]:
    """Return the distances of columns and of rows in um."""
    pixel_um = _length_um(facts, _PIXEL)
    dx_um, dy_um = _length_um(facts, _PIXEL_X) or pixel_um, _length_um(facts, _PIXEL_Y) or pixel_um
    width_um, height_um = _length_um(facts, _WIDTH), _length_um(facts, _HEIGHT)
    if dx_um is None and width_um is not None and height_um is not None:
        return width_um / shape[1], height_um / shape[0]
    return dx_um, dy_um


def _require_heights_alone(raw: NDArray[np.float64], facts: Facts, options: ReadOptions) -> None:
    """Raise DatasetError when the header states other numbers of rows or columns, or coordinates frame the heights."""
    for names, found in ((_ROWS, raw.shape[0]), (_COLUMNS, raw.shape[1])):
        value, unit = _find(facts, names) or (found, "")
        if not unit and value != found:
            raise options.refuse(f"states {value:g} {names[1]} and has {found}: copy it again.")
    if min(raw.shape) > 3 and np.isnan(raw[0, 0]) and _is_even(raw[0, 1:]) and _is_even(raw[1:, 0]):
        raise options.refuse("has coordinates in its first line and column: take them out, and give --pixel-um.")


def _is_even(values: NDArray[np.float64]) -> bool:
    steps = np.diff(values)
    return bool(np.isfinite(steps).all() and steps[0] and np.ptp(steps) <= 1e-3 * abs(steps[0]))


_SENTINELS = (
    *(-32768.0, -32767.0, 32767.0, -2147483648.0, 2147483647.0, 1000001.0),
    *(sign * value for sign in (1.0, -1.0) for value in (999.0, 9999.0, 99999.0, 999999.0, 1e6)),
)
"""Numbers that programs write for an unmeasured height, with those of `_HUGE` and beyond."""
_HUGE = 1e9
_FAR = 3.0
"""Distance of a sentinel from the heights, in ranges of the heights."""


def remove_sentinels(options: ReadOptions, raw: NDArray[np.float64]) -> None:
    """Replace usual numbers for gaps by NaN, with a note, if they occur repeatedly and far beyond all other heights."""
    known = raw[np.isfinite(raw)]
    is_sentinel = np.isin(known, _SENTINELS) | (np.abs(known) >= _HUGE)
    heights = known[~is_sentinel]
    if not is_sentinel.any() or not heights.size:
        return
    low, high = float(heights.min()), float(heights.max())
    values, counts = np.unique(known[is_sentinel], return_counts=True)
    for value, n in zip(values.tolist(), counts.tolist(), strict=True):
        if n > 1 and max(low - value, value - high) > _FAR * (high - low):
            raw[raw == value] = np.nan
            options.notes.append(f"{n} of its values are {value:g}, far beyond all heights: they were taken as gaps.")
        else:
            options.notes.append(f"{n} of its heights are exactly {value:g}, as some programs write gaps: check them.")
