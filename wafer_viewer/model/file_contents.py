"""Contents of a file or folder that may be imported: facts with their sources, frames in order, and doubts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Kind = Literal["images", "surface", "dataset"]
DATASET_ENDING = ".wafer"
"""Of the folders that hold a scan, its images and surfaces."""


@dataclass(frozen=True, slots=True)
class Fact:
    """One fact on a source, such as ``pixel size``, ``0.65 um``. source: where it was found, or empty."""

    name: str
    value: str
    source: str = ""


@dataclass(frozen=True, slots=True)
class FrameFact:
    """One frame in the order of its z.

    name: of its file; empty where the frame is missing. z_um: from the lowest, None if unknown. sharpness: at places
    spread over the frame, each from 0 to 1 of its sharpest; empty if it was not asked for. key: by which the stored
    image is known again until its file changes; empty if it was not looked at.
    """

    name: str
    z_um: float | None
    sharpness: tuple[float, ...] = ()
    key: str = ""


@dataclass(frozen=True, slots=True)
class AxisChoice:
    """Names on an axis, channel, time or position, of which one can be taken."""

    axis: str
    names: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class FileContents:
    """Contents of a source of images or heights.

    name: of the file or folder. facts: in the order of reading. frames: of the first field, or the image
    of each field. fields: how many.
    notes: one sentence each on how it is read. doubts: what has to be settled before it can be imported, with the mend.
    unsettled: names of the facts that doubts are about; their values are empty where unknown, several where they
    contradict each other. left_out: files that are not taken. choices: axes with several names. places_um: centres of
    the fields on the sample; field_um: width and height of a field, None if unknown. n_bytes: of all images.
    is_tiled: True for several fields of one image each, which make a picture and no heights.
    """

    name: str
    kind: Kind
    facts: tuple[Fact, ...]
    frames: tuple[FrameFact, ...] = ()
    fields: int = 1
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    unsettled: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    choices: tuple[AxisChoice, ...] = ()
    places_um: tuple[tuple[float, float], ...] = ()
    field_um: tuple[float, float] | None = None
    n_bytes: int = 0
    is_tiled: bool = False

    @property
    def n_missing(self) -> int:
        """Number of frames of the first field that are missing."""
        return sum(not frame.name for frame in self.frames)

    @property
    def can_import(self) -> bool:
        """True if nothing has to be settled before."""
        return not self.doubts
