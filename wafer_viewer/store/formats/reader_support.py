"""Conversion of file values to a surface: units, signs, lattices, and errors with the reason."""

from __future__ import annotations

import datetime
import json
import math
import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import DatasetError, WaferViewerError, parser_errors_as
from wafer_viewer.model.progress import Progress, ShouldStop, with_progress
from wafer_viewer.model.spec import decode, encode, replace
from wafer_viewer.model.surface.height_map import HeightMap, Mosaic, Origin, Provenance
from wafer_viewer.model.surface_format import Reading
from wafer_viewer.store.formats.surface_strips import STRIP_ROWS, Strips

# ---------------------------------------------------------------------------------------------------- embedded metadata


OURS = "WaferViewer"
"""Key of the machine-readable text in formats with named texts."""
LINE_LETTERS = 200
_SIMULATED = "SIMULATED"
_STATED = re.compile(rf"\b{_SIMULATED}\b")


class EmbeddedMetadata(msgspec.Struct, frozen=True):
    """Lattice of a written file, and provenance of its surface."""

    pixel_um: float
    x0_um: float
    y0_um: float
    rows: int
    cols: int
    provenance: Provenance
    kind: str = "height"


def caveats(provenance: Provenance, today: str | None = None) -> tuple[str, ...]:
    """Return the warnings on the numbers: 'SIMULATED', and 'uncalibrated' with the reason; empty if there are none.

    today: an ISO 8601 date, by default the current one.
    """
    day = today or datetime.date.today().isoformat()
    calibration = provenance.calibration
    problem = "no calibration" if calibration is None else calibration.problem(calibration.setup, day)
    return ((_SIMULATED,) if provenance.simulated else ()) + ((f"uncalibrated: {problem}",) if problem else ())


def title(surface: HeightMap | Mosaic) -> str:
    """Return a readable title with the program version and the caveats."""
    return "; ".join((f"Heights by Wafer Viewer {surface.provenance.software_version}", *caveats(surface.provenance)))


def heading(strips: Strips) -> list[str]:
    """Return the header lines of a text file; the last ones are machine-readable, split into short lines."""
    surface, (rows, cols) = strips.surface, strips.shape
    return [
        f"Wafer Viewer {surface.provenance.software_version}: heights in um, stage coordinates",
        *caveats(surface.provenance),
        f"x = {surface.x0_um:.4f} + col * {strips.pixel_um:.8g}, y = {surface.y0_um:.4f} - row * {strips.pixel_um:.8g}",
        f"{rows} rows, {cols} columns",
        f"origin: {', '.join(f'{o.value} {o.name.lower()}' for o in Origin if o < Origin.NOT_COVERED)}",
        f"input checksum: {surface.provenance.input_checksum or 'none'}",
        *(f"{OURS}: {part}" for part in _in_short_lines(about(strips))),
    ]


def _in_short_lines(text: str) -> list[str]:
    """Split JSON into lines without blanks: some programs fail at a line or word of some hundred characters."""
    escaped = text.replace(" ", "\\u0020")
    return [escaped[start : start + LINE_LETTERS] for start in range(0, len(escaped), LINE_LETTERS)]


def about(strips: Strips) -> str:
    """Return the machine-readable text: one line of ASCII JSON."""
    surface, provenance = strips.surface, strips.surface.provenance
    facts = {
        "software": f"Wafer Viewer {provenance.software_version}",
        "unit": "um",
        "caveats": caveats(provenance),
        "pixel_um": strips.pixel_um,
        "x0_um": surface.x0_um,
        "y0_um": surface.y0_um,
        "rows": strips.shape[0],
        "cols": strips.shape[1],
        "provenance": json.loads(encode(provenance, "json")),
    }
    return json.dumps(facts, ensure_ascii=True, separators=(",", ":"))


def parse_metadata(text: str | None) -> EmbeddedMetadata | None:
    """Parse the machine-readable text; None if there is none or it is of an incompatible version."""
    foreign = DatasetError(f"{OURS} has another form.")
    with suppress(WaferViewerError), parser_errors_as(lambda _: foreign):
        facts: Any = json.loads(text or "")
        provenance = decode(json.dumps(facts["provenance"]), Provenance, OURS, "json")
        return msgspec.convert({**facts, "provenance": provenance}, EmbeddedMetadata)
    return None


def provenance_of(metadata: EmbeddedMetadata | None, embedded: str | None, *texts: str | None) -> Provenance | None:
    """Return the provenance of a surface that was read, None if its file says nothing of it.

    A title or comment for people that says SIMULATED counts, and so does `embedded`, the machine-readable text, where
    it could not be parsed: other programs drop or change one and leave the other.
    """
    readable = texts if metadata is not None else (*texts, embedded)
    stated = any(_STATED.search(text or "") for text in readable)
    if metadata is None:
        return Provenance(simulated=True) if stated else None
    return replace(metadata.provenance, simulated=metadata.provenance.simulated or stated)


# ------------------------------------------------------------------------------------------------------- reader support


UNITS_UM = {
    **dict.fromkeys(("m", "meter", "metre", "meters", "metres"), 1e6),
    **dict.fromkeys(("cm", "centimeter", "centimetre"), 1e4),
    **dict.fromkeys(("mm", "millimeter", "millimetre", "millimeters"), 1e3),
    **dict.fromkeys(("um", "µm", "μm", "micron", "microns", "micrometer", "micrometre", "micrometers"), 1.0),
    **dict.fromkeys(("nm", "nanometer", "nanometre", "nanometers"), 1e-3),
    **dict.fromkeys(("Å", "Å", "angstrom"), 1e-4),
    **dict.fromkeys(("pm", "picometer", "picometre"), 1e-6),
    **dict.fromkeys(("in", "inch", "inches"), 25400.0),
}
"""Units of length, in um."""
_ROUND_OFF = 1e-3
"""Relative tolerance between two values of the same length."""
Heights = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """File being read: its name, the options of the user, and the progress callbacks."""

    name: str
    overrides: Reading = Reading()
    progress: Progress | None = None
    should_stop: ShouldStop | None = None
    notes: list[str] = field(default_factory=list[str])
    """Remarks on the data, added by the readers."""

    def refuse(self, why: str) -> DatasetError:
        """Return the error with the reason why the file is not read."""
        return DatasetError(f"{self.name} {why}")

    def require_heights_up(self, quantity: str) -> None:
        """Raise DatasetError for depths, unless the user requested an inverted z."""
        if quantity.strip().lower().startswith("depth") and not self.overrides.invert_z:
            raise self.refuse(f"holds depths, not heights ({quantity}): give --invert-z to invert them.")

    def z_scale_um(self, unit: str | None) -> float:
        """Return the factor from file heights to um, by the unit of the file or that given by the user."""
        sign = -1.0 if self.overrides.invert_z else 1.0
        given = self.overrides.z_unit
        if not unit and given is None:
            raise self.refuse("states no unit of its heights: give it, as in --z-unit um.")
        if not unit:
            return sign * self._length(given or "", "--z-unit")
        if given is not None and not same(self._length(given, "--z-unit"), self._length(unit, "its heights")):
            raise self.refuse(f"states heights in {unit}, but --z-unit is {given}: leave --z-unit out.")
        return sign * self._length(unit, "its heights")

    def lateral_um(self, unit: str | None, quantity: str = "its x and y") -> float | None:
        """Return a lateral unit in um; None if the file gives none."""
        return self._length(unit, quantity) if unit else None

    def pixel_um(self, dx_um: float | None, dy_um: float | None = None) -> float:
        """Return the pixel size in um. Raises DatasetError if not square, or the user's value differs."""
        dx_um, dy_um = self.pitches_um(dx_um, dy_um)
        if not same(dx_um, dy_um):
            raise self.refuse(
                f"has pixels of {dx_um:.6g} x {dy_um:.6g} um: resample it to square pixels before, as Gwyddion does."
            )
        return dx_um

    def pitches_um(self, dx_um: float | None, dy_um: float | None = None) -> tuple[float, float]:
        """Return the distances of columns and of rows in um. Raises DatasetError if the user's value differs."""
        given = self.overrides.pixel_um
        if dx_um is None or not math.isfinite(dx_um) or dx_um == 0:
            if given is None:
                raise self.refuse("states no pixel size: give it, as in --pixel-um 0.5.")
            return given, given
        dy_um = dx_um if dy_um is None else dy_um
        if dx_um < 0 or dy_um < 0:
            raise self.refuse("is mirrored, a step along x or y is negative: write it with positive steps.")
        if given is not None and not (same(given, dx_um) and same(given, dy_um)):
            stated = f"{dx_um:.6g}" if same(dx_um, dy_um) else f"{dx_um:.6g} x {dy_um:.6g}"
            raise self.refuse(f"states pixels of {stated} um, but --pixel-um is {given:g}: leave --pixel-um out.")
        return dx_um, dy_um

    def watch(self, items: list[Any]) -> Iterator[Any]:
        """Yield the items with a progress report after each. Raises DatasetError when stopped."""
        return with_progress(items, len(items), f"Reading {self.name}", self.progress, self.should_stop)

    def _length(self, unit: str, quantity: str) -> float:
        factor = UNITS_UM.get(unit.strip()) or UNITS_UM.get(unit.strip().lower())
        if factor is None:
            raise self.refuse(
                f"gives {quantity} in '{unit}', which is not a unit of length that is known: use m, mm, um or nm."
            )
        return factor


def scaled(
    options: ReadOptions, raw: NDArray[Any], factor: float, offset_um: float = 0.0, *, is_ours: bool = False
) -> Heights:
    """Convert raw values [row, col] to heights in um; a large mean is taken off those of other programs."""
    strips = [raw[top : top + STRIP_ROWS] for top in range(0, raw.shape[0], STRIP_ROWS)]
    if not is_ours and raw.size:
        finite = [strip[np.isfinite(strip)] for strip in strips]
        ends = [float(end) * factor + offset_um for part in finite if part.size for end in (part.min(), part.max())]
        offset_um -= common_height_um(options, ends)
    heights = np.empty(raw.shape, np.float32)
    for top in options.watch(list(range(0, raw.shape[0], STRIP_ROWS))):
        rows = slice(top, top + STRIP_ROWS)
        heights[rows] = raw[rows].astype(np.float64) * factor + offset_um
    return heights


_FINEST_UM = 1e-4
"""Rounding of 32-bit heights that is accepted: a tenth of a nanometre, far below the noise of any instrument."""


def common_height_um(options: ReadOptions, ends_um: list[float]) -> float:
    """Return what to take off heights within `ends_um` before 32-bit floats round them, with a note; usually 0."""
    largest = max((abs(end) for end in ends_um), default=0.0)
    rounding_um = float(np.spacing(np.float32(largest)))
    if not math.isfinite(rounding_um) or rounding_um <= _FINEST_UM:
        return 0.0
    low, high = min(ends_um), max(ends_um)
    if 8 * (high - low) > abs(low + high):
        return 0.0
    common_um = float(round((low + high) / 2))
    options.notes.append(
        f"{common_um:.0f} um were taken off its heights, which 32-bit floats would have rounded to "
        f"{rounding_um * 1e3:.2g} nm there."
    )
    return common_um


def heights_only(
    options: ReadOptions,
    z_um: Heights,
    pixel_um: float,
    x0_um: float,
    y0_um: float,
    provenance: Provenance | None,
    held: str = "heights only",
) -> HeightMap:
    """Return the surface of a file that holds only heights; missing layers take no memory.

    Raises DatasetError if there is no height.
    """
    finite = np.isfinite(z_um)
    require_some(options, finite)
    z_um[~finite] = np.nan
    came_from = provenance or Provenance()
    options.notes.insert(0, f"Read from {options.name}: {held}.")
    return HeightMap(
        z_um=z_um,
        z_raw_um=z_um,
        confidence=np.broadcast_to(np.float32(1), z_um.shape),
        all_in_focus=np.broadcast_to(np.uint8(0), z_um.shape),
        origin=np.where(finite, np.uint8(Origin.MEASURED), np.uint8(Origin.NO_REASON)),
        pixel_um=pixel_um,
        x0_um=x0_um,
        y0_um=y0_um,
        provenance=replace(came_from, notes=(*came_from.notes, *options.notes)),
    )


_MOST_DRIFT_PX = 0.1
"""Largest error of a pixel's place that is accepted, rather than a resampling, where pixels are nearly square."""
_ROUNDED = 1e-6
"""Relative difference of two pitches that is a rounding in the file."""
_LONGEST = 10.0
"""Largest ratio of the sides of a pixel that is resampled: beyond it, most heights would be interpolated."""


def on_square_pixels(options: ReadOptions, z_um: Heights, dx_um: float, dy_um: float) -> tuple[Heights, float]:
    """Return heights [row, col] on square pixels, and their size in um; a note tells what was lost.

    Where rows and columns differ in distance, the sparser ones are interpolated linearly, without bridging gaps. A
    difference that moves no pixel by a tenth of one is kept as it is. Raises DatasetError for pixels over ten times
    as long as wide.
    """
    low, high = sorted((dx_um, dy_um))
    axis, name = (0, "y") if dy_um > dx_um else (1, "x")
    excess, n = high / low - 1, z_um.shape[axis]
    sides = f"{dx_um:.7g} x {dy_um:.7g} um"
    if excess * (n - 1) <= _MOST_DRIFT_PX:
        if excess > _ROUNDED:
            off_um = excess * (n - 1) * low
            options.notes.append(
                f"Its pixels of {sides} were taken as squares of {low:.7g} um: {name} is short by {off_um:.2g} um "
                "over the surface."
            )
        return z_um, low
    if high > _LONGEST * low:
        raise options.refuse(f"has pixels of {sides}, over ten times as long as wide: resample it before.")
    options.notes.append(
        f"Its pixels of {sides} were resampled to {low:.7g} um along {name}, by linear interpolation: "
        f"no detail along {name} is finer than {high:.7g} um."
    )
    return _interpolated(z_um, axis, low / high), low


def _interpolated(z_um: Heights, axis: int, step: float) -> Heights:
    """Return heights at every `step` of a row (axis 0) or column (axis 1), NaN next to a gap."""
    source = z_um if axis == 0 else z_um.T
    places = np.arange(int((len(source) - 1) / step + 1e-6) + 1) * step
    first = np.minimum((places + 1e-6).astype(np.intp), len(source) - 1)
    share = np.where(places - first < 2e-6, 0.0, places - first)
    out = np.empty((len(places), source.shape[1]), np.float32)
    for top in range(0, len(places), STRIP_ROWS):
        rows = slice(top, top + STRIP_ROWS)
        weight, low = share[rows, None], source[first[rows]].astype(np.float64)
        high = source[np.minimum(first[rows] + 1, len(source) - 1)]
        out[rows] = np.where(weight == 0, low, low * (1 - weight) + high * weight)
    return out if axis == 0 else np.ascontiguousarray(out.T)


def require_some(options: ReadOptions, finite: NDArray[np.bool_]) -> None:
    """Raise DatasetError if no pixel is known."""
    if not finite.any():
        raise options.refuse("contains no heights: export it again from a measured surface.")


def same(a: float, b: float) -> bool:
    """Return whether two values of the same length agree."""
    return math.isclose(a, b, rel_tol=_ROUND_OFF)
