"""Render requests and answers for comparison views of a position, and for the typical die."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import msgspec

from wafer_viewer.model.inspection.die_grid import DieGrid

if TYPE_CHECKING:
    from wafer_viewer.session.rendering.render_request import SurfaceKey

Place = tuple[int, int]
"""(col, row) of a die."""
Like = Literal["here", "dies", "golden", "before"]
"""Source of a view: the position itself; the median of other dies; a stored golden die; an earlier scan."""


@dataclass(frozen=True, slots=True)
class ComparisonRequest:
    """Request for comparison views of a position.

    die: the die of the position, dies: those of the median, without it; golden: name of the stored golden die shown
    instead, of the product `product`. defect_um: box of the defect, which the height range must not clip. before: an
    earlier scan, before_name: its name, before_at_um: position of the box centre on its stage, before_turn_rad: its
    rotation, anticlockwise; no_before: the reason if there is none.
    """

    grid: DieGrid | None = None
    die: Place | None = None
    dies: tuple[Place, ...] = ()
    golden: str = ""
    product: str = ""
    defect_um: tuple[float, float, float, float] | None = None
    before: SurfaceKey | None = None
    before_at_um: tuple[float, float] | None = None
    before_turn_rad: float = 0.0
    before_name: str = ""
    no_before: str = ""


class ComparisonView(msgspec.Struct, frozen=True):
    """View in a side-by-side comparison: heights and the all-in-focus picture, as JPEG.

    name: of the golden die or the scan; dies: number of dies in the median; moved_um: shift (right, up) applied to
    match the position; alike: their correlation. why_not: the reason if there is no view, a sentence.
    """

    like: Like
    height: bytes = b""
    picture: bytes = b""
    name: str = ""
    dies: int = 0
    moved_um: tuple[float, float] = (0.0, 0.0)
    alike: float = 1.0
    why_not: str = ""


class ComparisonViews(msgspec.Struct, frozen=True):
    """Comparison views of a position, answer to ``beside``: heights in the range low_um to high_um above zero_um.

    box_um: area of each picture, stage um (x low, y low, x high, y high).
    """

    low_um: float
    high_um: float
    zero_um: float
    box_um: tuple[float, float, float, float]
    pixel_um: float
    seen: tuple[ComparisonView, ...]


class DiePicture(msgspec.Struct, frozen=True):
    """Typical die, answer to ``die``: the all-in-focus picture as JPEG, and the number of dies.

    golden: name of the stored golden die, if it shows one; why_not: the reason if there is none, a sentence.
    """

    picture: bytes = b""
    dies: int = 0
    golden: str = ""
    why_not: str = ""
