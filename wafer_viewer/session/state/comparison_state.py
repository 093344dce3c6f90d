"""A comparison of the open dataset as the snapshot shows it."""

from __future__ import annotations

from dataclasses import dataclass

from wafer_viewer.model.surface.comparison import Comparison


@dataclass(frozen=True, slots=True)
class Compared:
    """A comparison that can be looked at. `stamp` changes whenever it does; outdated: a surface was made anew since."""

    number: int
    name: str
    comparison: Comparison
    stamp: int
    outdated: bool = False
