"""Sections to be drawn and written: which line of which surface is asked for, and what came of it."""

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
    """A stitched surface beside the one being looked at: a result of this or of another dataset's folder."""

    folder: str
    result: str

    @property
    def title(self) -> str:
        """What it is called: the dataset, and the result where it is not the usual one."""
        name = PurePath(self.folder).stem
        return name if self.result == "default" else f"{name} · {self.result}"


@dataclass(frozen=True, slots=True, eq=False)
class SlabPoints:
    """The measured points of a slab: distance along it and height in um, float32 [n].

    width_um: of the slab; spread_um: 68 % of the points lie within so much of the running median.
    """

    distance_um: NDArray[np.float32]
    z_um: NDArray[np.float32]
    width_um: float
    spread_um: float

    def __len__(self) -> int:
        return len(self.z_um)


@dataclass(frozen=True, slots=True)
class SectionAsked:
    """One curve: a line, of what surface, read from what zero.

    place: the line's, 0 is A; show: 0 the stitched surface, else a field; cleaned: the other of measured and filtered
    heights than those that are measured on; of: another surface instead; slab: the points of the slab along the line
    and their running median, instead of the mean across the line.
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
        """The line's name."""
        return LETTERS[self.place]

    @property
    def is_second(self) -> bool:
        """Whether it is laid over the line's own curve, to be compared with it."""
        return self.cleaned or self.of is not None


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """A curve with its numbers. source: the dataset and the part of it, as a reader would name them.

    points: those of the slab that the curve is the running median of; None of a mean across the line.
    """

    asked: SectionAsked
    profile: Profile
    curve: ProfileCurve
    source: str
    points: SlabPoints | None = None

    @property
    def title(self) -> str:
        """What tells it from the others: ``A``, ``A filled``, ``A coupon-08``."""
        if self.asked.of is not None:
            return f"{self.asked.letter} {self.asked.of.title}"
        return f"{self.asked.letter} {LAYER_TITLES[self.profile.surface]}" if self.asked.cleaned else self.asked.letter
