"""From the numbers of a file to a surface: units, signs, lattices, and what is refused with the reason."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.file_formats import Reading
from wafer_viewer.model.progress import Progress, ShouldStop
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import HeightMap, Origin, Provenance
from wafer_viewer.store.formats.surface_strips import STRIP_ROWS
from wafer_viewer.store.io.progress import watched

UNITS_UM = {
    **dict.fromkeys(("m", "meter", "metre", "meters", "metres"), 1e6),
    **dict.fromkeys(("cm", "centimeter", "centimetre"), 1e4),
    **dict.fromkeys(("mm", "millimeter", "millimetre", "millimeters"), 1e3),
    **dict.fromkeys(("um", "µm", "μm", "micron", "microns", "micrometer", "micrometre", "micrometers"), 1.0),
    **dict.fromkeys(("nm", "nanometer", "nanometre", "nanometers"), 1e-3),
    **dict.fromkeys(("pm", "picometer", "picometre"), 1e-6),
    **dict.fromkeys(("in", "inch", "inches"), 25400.0),
}
"""Units of length, in um."""
_ROUND_OFF = 1e-3
"""By how much two statements of one length may differ, relatively."""
Heights = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """A file that is being read: its name, what a person says of it, and who hears how far it is."""

    name: str
    says: Reading = Reading()
    progress: Progress | None = None
    should_stop: ShouldStop | None = None
    notes: list[str] = field(default_factory=list[str])
    """What a reader of the numbers should know; the readers add to it."""

    def refuse(self, why: str) -> DatasetError:
        """The error that says why the file is not read."""
        return DatasetError(f"{self.name} {why}")

    def require_heights_up(self, quantity: str) -> None:
        """Refuse what a file calls depths, unless a person said that they be turned over."""
        if quantity.strip().lower().startswith("depth") and not self.says.invert_z:
            raise self.refuse(f"holds depths, not heights ({quantity}): give --invert-z to invert them.")

    def z_scale_um(self, unit: str | None) -> float:
        """What heights are multiplied with, by the unit that the file gives and the one that a person gives."""
        sign = -1.0 if self.says.invert_z else 1.0
        given = self.says.z_unit
        if not unit and given is None:
            raise self.refuse("does not say the unit of its heights: give it, as in --z-unit um.")
        if not unit:
            return sign * self._length(given or "", "--z-unit")
        if given is not None and not same(self._length(given, "--z-unit"), self._length(unit, "its heights")):
            raise self.refuse(f"says that its heights are in {unit}, and --z-unit says {given}: leave --z-unit out.")
        return sign * self._length(unit, "its heights")

    def lateral_um(self, unit: str | None, what: str = "its x and y") -> float | None:
        """A lateral unit in um; None where the file gives none."""
        return self._length(unit, what) if unit else None

    def pixel_um(self, dx_um: float | None, dy_um: float | None = None) -> float:
        """The pixel size, by the file's two and a person's. Pixels must be square, and both must say the same."""
        given = self.says.pixel_um
        if dx_um is None or not math.isfinite(dx_um) or dx_um == 0:
            if given is None:
                raise self.refuse("does not say its pixel size: give it, as in --pixel-um 0.5.")
            return given
        dy_um = dx_um if dy_um is None else dy_um
        if dx_um < 0 or dy_um < 0:
            raise self.refuse("is mirrored, a step along x or y is negative: write it with positive steps.")
        if not same(dx_um, dy_um):
            raise self.refuse(
                f"has pixels of {dx_um:.6g} x {dy_um:.6g} um: resample it to square pixels before, as Gwyddion does."
            )
        if given is not None and not same(given, dx_um):
            raise self.refuse(f"says that a pixel is {dx_um:.6g} um, and --pixel-um {given:g}: leave --pixel-um out.")
        return dx_um

    def watch(self, items: list[Any]) -> Iterator[Any]:
        """The items, with progress told after each. Raises DatasetError when the work is to stop."""
        return watched(items, len(items), f"Reading {self.name}", self.progress, self.should_stop)

    def _length(self, unit: str, what: str) -> float:
        found = UNITS_UM.get(unit.strip()) or UNITS_UM.get(unit.strip().lower())
        if found is None:
            raise self.refuse(
                f"gives {what} in '{unit}', which is not a unit of length that is known: use m, mm, um or nm."
            )
        return found


def scaled(asked: ReadOptions, raw: NDArray[Any], factor: float, offset_um: float = 0.0) -> Heights:
    """Raw numbers [row, col] as heights in um, strip by strip."""
    heights = np.empty(raw.shape, np.float32)
    for top in asked.watch(list(range(0, raw.shape[0], STRIP_ROWS))):
        rows = slice(top, top + STRIP_ROWS)
        heights[rows] = raw[rows].astype(np.float64) * factor + offset_um
    return heights


def heights_only(
    asked: ReadOptions,
    z_um: Heights,
    pixel_um: float,
    x0_um: float,
    y0_um: float,
    provenance: Provenance | None,
    held: str = "heights only",
) -> HeightMap:
    """The surface of a file that holds heights and nothing else; what it lacks takes no memory.

    Raises DatasetError where there is no height.
    """
    known = np.isfinite(z_um)
    require_some(asked, known)
    z_um[~known] = np.nan
    came_from = provenance or Provenance()
    asked.notes.insert(0, f"Read from {asked.name}: {held}.")
    return HeightMap(
        z_um=z_um,
        z_raw_um=z_um,
        confidence=np.broadcast_to(np.float32(1), z_um.shape),
        all_in_focus=np.broadcast_to(np.uint8(0), z_um.shape),
        origin=np.where(known, np.uint8(Origin.MEASURED), np.uint8(Origin.NO_REASON)),
        pixel_um=pixel_um,
        x0_um=x0_um,
        y0_um=y0_um,
        provenance=replace(came_from, notes=(*came_from.notes, *asked.notes)),
    )


def require_some(asked: ReadOptions, known: NDArray[np.bool_]) -> None:
    """Raise DatasetError where nothing is known."""
    if not known.any():
        raise asked.refuse("holds no height: write it again from a surface that has some.")


def same(a: float, b: float) -> bool:
    """Whether two statements of one length agree."""
    return math.isclose(a, b, rel_tol=_ROUND_OFF)
