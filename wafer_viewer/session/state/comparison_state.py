"""Comparison of the open dataset, as in the snapshot."""

from __future__ import annotations

from dataclasses import dataclass

from wafer_viewer.model.surface.comparison import Comparison


@dataclass(frozen=True, slots=True)
class Compared:
    """Comparison that can be displayed.

    `stamp` changes whenever it does; outdated: a surface has been recomputed since.
    """

    number: int
    name: str
    comparison: Comparison
    stamp: int
    outdated: bool = False
