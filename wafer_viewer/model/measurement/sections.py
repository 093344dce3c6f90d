"""Sections for display and export: the requested lines and surfaces, and the resulting curves."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import PurePath

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.measurement.levelling import Levelling
from wafer_viewer.model.measurement.measurements import Profile, ProfileCurve
from wafer_viewer.model.measurement.section_lines import LETTERS
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import LAYER_TITLES


@dataclass(frozen=True, slots=True)
class OtherSurface:
    """Another stitched surface for comparison: a result of this or another dataset's folder."""

    folder: str
    result: str

    @property
    def title(self) -> str:
        """Title: the dataset, and the result unless it is the default one."""
        name = PurePath(self.folder).stem
        return name if self.result == "default" else f"{name} · {self.result}"


@dataclass(frozen=True, slots=True, eq=False)
class SlabPoints:
    """Measured points of a slab: distance along it and height in um, float32 [n].

    width_um: of the slab; spread_um: distance from the running median that contains 68 % of the points.
    """

    distance_um: NDArray[np.float32]
    z_um: NDArray[np.float32]
    width_um: float
    spread_um: float

    def __len__(self) -> int:
        return len(self.z_um)


@dataclass(frozen=True, slots=True)
class SectionAsked:
    """A requested curve: its line, surface and levelling.

    place: index of the line, 0 is A; show: 0 for the stitched surface, else a field; cleaned: whichever of measured and
    filtered heights is not used for measuring; of: another surface instead; slab: points of the slab along the line and
    their running median, instead of the mean across the line.
    """

    place: int
    line: Region
    show: int = 0
    levelling: Levelling = Levelling()
    cleaned: bool = False
    of: OtherSurface | None = None
    slab: bool = False

    @property
    def letter(self) -> str:
        """Letter of the line."""
        return LETTERS[self.place]

    @property
    def is_second(self) -> bool:
        """True if it is drawn over the line's own curve for comparison."""
        return self.cleaned or self.of is not None


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """A section: curve, numbers and source, the names of the dataset and its part.

    points: of the slab whose running median the curve is; None for a mean across the line.
    """

    asked: SectionAsked
    profile: Profile
    curve: ProfileCurve
    source: str
    points: SlabPoints | None = None

    @property
    def title(self) -> str:
        """Distinguishing title: ``A``, ``A filled``, ``A coupon-08``."""
        if self.asked.of is not None:
            return f"{self.asked.letter} {self.asked.of.title}"
        return f"{self.asked.letter} {LAYER_TITLES[self.profile.surface]}" if self.asked.cleaned else self.asked.letter
