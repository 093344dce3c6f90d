"""Contents of a file or folder that may be imported: facts with their sources, frames in order, and doubts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Kind = Literal["images", "surface", "dataset"]


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
    spread over the frame, each from 0 to 1 of its sharpest; empty if it was not asked for.
    """

    name: str
    z_um: float | None
    sharpness: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class FileContents:
    """Contents of a source of images or heights.

    name: of the file or folder. facts: in the order of reading. frames: of the first field. fields: how many.
    notes: one sentence each on how it is read. doubts: what has to be settled before it can be imported, with the mend.
    """

    name: str
    kind: Kind
    facts: tuple[Fact, ...]
    frames: tuple[FrameFact, ...] = ()
    fields: int = 1
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()

    @property
    def can_import(self) -> bool:
        """True if nothing has to be settled before."""
        return not self.doubts
