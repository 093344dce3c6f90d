"""What the painter is asked for to show a place compared, or a die as all of them are, and what comes back."""

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
"""The place itself; the usual of the other dies; a stored golden die; the same place of an earlier scan."""


@dataclass(frozen=True, slots=True)
class ComparisonRequest:
    """What a place is to be shown beside.

    die: the one it lies on, dies: those whose median is taken, without it; golden: the name of the stored golden die
    that is shown in their place, of which product. defect_um: the box of what differs, which no range of heights may
    cut off. before: an earlier scan, before_name: what it is called, before_at_um: where on its stage the middle of the
    box lies, and how it is turned there, anticlockwise; no_before: why there is none.
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
    """One of the pictures that stand side by side: heights and the picture in focus everywhere, as JPEG.

    name: of the golden die or the scan; dies: of how many dies it is the median; moved_um: how far it was moved (right,
    up) to lie on the place; alike: their correlation. why_not: why there is nothing to be seen, a sentence.
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
    """A place and its like, answer to ``beside``: all heights in the range low_um to high_um over zero_um.

    box_um: what each picture takes in, stage um (x low, y low, x high, y high).
    """

    low_um: float
    high_um: float
    zero_um: float
    box_um: tuple[float, float, float, float]
    pixel_um: float
    seen: tuple[ComparisonView, ...]


class DiePicture(msgspec.Struct, frozen=True):
    """A die as all of them are, answer to ``die``: the picture in focus everywhere as JPEG, of how many dies.

    golden: the name of the stored golden die it is of, if it is one; why_not: why there is none, a sentence.
    """

    picture: bytes = b""
    dies: int = 0
    golden: str = ""
    why_not: str = ""
