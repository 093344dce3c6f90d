"""Render requests of the page, and answers that are not pictures."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from wafer_viewer.draw.surface.display_style import DisplayStyle, Form, Light
from wafer_viewer.draw.surface.mesh import Skirts
from wafer_viewer.model.inspection.die_grid import DieGrid
from wafer_viewer.model.measurement.tool_options import Datum
from wafer_viewer.model.surface.clipping import Clip, LeftOut, Span

Place = tuple[int, int]
"""(col, row) of a die."""
Like = Literal["here", "dies", "golden", "before"]
"""Source of a view: the position itself; the median of other dies; a stored golden die; an earlier scan."""


@dataclass(frozen=True, slots=True)
class ComparisonRequest:
    """Request for comparison views of a position.

    die: the die of the position, dies: those of the median, without it; golden: name of the stored golden die shown
    instead, of the product `product`. defect_um: box of the defect, which the height range must not clip.
    section_um: ends of a line through it, stage um (x, y of each). before: an earlier scan, before_name: its name,
    before_at_um: position of the box centre on its stage, before_turn_rad: its rotation, anticlockwise; no_before:
    the reason if there is none.
    """

    grid: DieGrid | None = None
    die: Place | None = None
    dies: tuple[Place, ...] = ()
    golden: str = ""
    product: str = ""
    defect_um: tuple[float, float, float, float] | None = None
    section_um: tuple[float, float, float, float] | None = None
    before: SurfaceKey | None = None
    before_at_um: tuple[float, float] | None = None
    before_turn_rad: float = 0.0
    before_name: str = ""
    no_before: str = ""


class ComparisonView(msgspec.Struct, frozen=True):
    """View in a side-by-side comparison: heights and the all-in-focus picture, as JPEG.

    height_difference, picture_difference: of the position itself from it, as JPEG; empty for the position itself.
    section: heights along the section line, over its first to its last point, and section_grey: grey values; levelled
    and matched in brightness as the pictures are, NaN where unknown.
    name: of the golden die or the scan; dies: number of dies in the median; moved_um: shift (right, up) applied to
    match the position; similarity: their correlation. why_not: the reason if there is no view, a sentence.
    """

    like: Like
    height: bytes = b""
    picture: bytes = b""
    height_difference: bytes = b""
    picture_difference: bytes = b""
    section: tuple[float, ...] = ()
    section_grey: tuple[float, ...] = ()
    name: str = ""
    dies: int = 0
    moved_um: tuple[float, float] = (0.0, 0.0)
    similarity: float = 1.0
    why_not: str = ""


class ComparisonViews(msgspec.Struct, frozen=True):
    """Comparison views of a position, answer to ``beside``: heights in the range low_um to high_um above zero_um.

    box_um: area of each picture, stage um (x low, y low, x high, y high). difference_um, difference_grey: half the
    range of the differences. section_um: ends of the section, stage um.
    """

    low_um: float
    high_um: float
    zero_um: float
    box_um: tuple[float, float, float, float]
    pixel_um: float
    views: tuple[ComparisonView, ...]
    difference_um: float = 0.0
    difference_grey: float = 0.0
    section_um: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)


class DiePicture(msgspec.Struct, frozen=True):
    """Typical die, answer to ``die``: the all-in-focus picture as JPEG, and the number of dies.

    golden: name of the stored golden die, if it shows one; why_not: the reason if there is none, a sentence.
    """

    picture: bytes = b""
    dies: int = 0
    golden: str = ""
    why_not: str = ""


Kind = Literal[
    "facts", "scale", "relief", "tile", "flat", "points", "walls", "frame", "slice", "picture", "beside", "die",
    "statistics",
]  # fmt: skip


@dataclass(frozen=True, slots=True)
class SurfaceKey:
    """Surface on disk: the stitched one (show 0) or that of a field. `stamp` changes whenever its contents do."""

    dataset: Path
    result: str
    show: int
    stamp: int


@dataclass(frozen=True, slots=True)
class RenderRequest:
    """Render request. Equal requests give the same picture, so answers are cached by request.

    level: pixels of 2 ** level times the surface's; rows, cols: [first, end) on that level's lattice; step: pixels from
    vertex to vertex; z0_um: the height at 0 in the scene; datum: reference of the heights, None for the stage's zero.
    skirts: whether a tile has a skirt at its foot, top, left and right edge, to hide the crack to a neighbour of
    another level; side: the edge for ``walls``, None for all. like: references for ``beside``, and the dies of the
    median for ``die``.

    `k` is for ``frame``, `z_um` for ``slice``, `range_values` for ``scale``: the range to count in, None for the
    quantity's own; `box_um` for ``picture`` and ``statistics``: x low, y low, x high, y high; `side_px`: the longer
    side of a picture, 0 for the default. clip: which points are drawn and counted. brush_um: heights over the datum
    whose points ``statistics`` counts and locates separately. refused: whether ``points`` draws and ``statistics``
    counts refused points as well.
    """

    source: SurfaceKey
    what: Kind
    level: int = 0
    rows: tuple[int, int] = (0, 0)
    cols: tuple[int, int] = (0, 0)
    step: int = 1
    look: DisplayStyle = DisplayStyle()
    light: Light = Light()
    z0_um: float = 0.0
    dark: bool = False
    k: int = 0
    z_um: float = 0.0
    range_values: tuple[float, float] | None = None
    box_um: tuple[float, float, float, float] | None = None
    side_px: int = 0
    datum: Datum | None = None
    skirts: Skirts = (False, False, False, False)
    side: int | None = None
    like: ComparisonRequest | None = None
    clip: Clip = Clip()
    brush_um: Span | None = None
    refused: bool = False


OPTIONAL_QUANTITIES = ("overlap", "uncertainty")
"""Quantities of layers that not every surface has."""


class SurfaceStatistics(msgspec.Struct, frozen=True):
    """Statistics of a surface, answer to ``facts``: its lattice, measured area, heights and light.

    has_overlaps: whether height differences between fields are known for pixels that several fields measured;
    has_uncertainty: whether uncertainties of single heights are known. by_probability: number of covered pixels by the
    probability that their height is right, in steps of 1 %, of a sample; empty where heights have none.
    """

    rows: int
    cols: int
    pixel_um: float
    x0_um: float
    y0_um: float
    first_row: int
    end_row: int
    first_col: int
    end_col: int
    lowest_um: float
    highest_um: float
    low_um: float
    high_um: float
    gain: float
    plane: tuple[float, float, float]
    has_overlaps: bool = False
    form: Form = ()
    has_uncertainty: bool = False
    by_probability: tuple[int, ...] = ()

    def kept_from(self, probability: float) -> tuple[float, float]:
        """Return the share of heights that are at least so probable, and the share of these expected to be false."""
        likely = np.arange(len(self.by_probability)) / 100 + 0.005
        kept = np.where(likely >= probability, self.by_probability, 0)
        n_kept, n_false = int(kept.sum()), float(kept @ (1 - likely))
        return n_kept / max(1, sum(self.by_probability)), n_false / max(1, n_kept)

    @property
    def unavailable(self) -> tuple[str, ...]:
        """Those of `OPTIONAL_QUANTITIES` that this surface cannot be coloured by."""
        available = self.has_overlaps, self.has_uncertainty
        return tuple(name for name, has in zip(OPTIONAL_QUANTITIES, available, strict=True) if not has)

    @property
    def light(self) -> Light:
        """Light for all tiles of the surface."""
        return Light(self.gain, max(self.high_um - self.low_um, 1e-3), self.plane, self.form)


class ColourScale(msgspec.Struct, frozen=True):
    """Value range of a quantity over the complete surface, answer to ``scale``, with a histogram.

    low, high: range of the colours; own_low, own_high: 0.5 and 99.5 %; p1, p99: 1 and 99 %; counts: in equal bins from
    low to high; origins: for the quantity ``origin``, the fraction of each code.
    """

    quantity: str
    low: float
    high: float
    own_low: float
    own_high: float
    p1: float
    p99: float
    counts: tuple[float, ...]
    origins: dict[int, float] = {}


class CoarseHeightField(msgspec.Struct, frozen=True):
    """Coarse surface for picking and draping, answer to ``relief``.

    z_um: float32 [row, col], gaps filled with the height of the nearest neighbour; measured: bool [row, col], False in
    gaps.
    """

    rows: int
    cols: int
    pixel_um: float
    x0_um: float
    y0_um: float
    z_um: bytes
    measured: bytes


class Brushed(msgspec.Struct, frozen=True):
    """Points in a height range: their number, mean and standard deviation, and their connected regions.

    fraction: of the counted points. n_places: number of connected groups of points; places: x low, y low, x high, y
    high in um of the largest of them, the largest first.
    """

    n_points: int
    fraction: float
    mean_um: float | None
    spread_um: float | None
    n_places: int
    places: tuple[tuple[float, float, float, float], ...] = ()


class RefusedCounts(msgspec.Struct, frozen=True):
    """Numbers of refused points: all of them, those inside the clip, and the others by reason.

    by_reason: those inside the clip, by code of `Origin`. n_fields: fields of the surface; n_fields_without: those of
    them reconstructed before refused heights were stored. span_um: lowest and highest of all refused heights.
    """

    n_heights: int
    n_points: int
    left_out: dict[LeftOut, int]
    by_reason: dict[int, int]
    n_fields: int
    n_fields_without: int
    span_um: tuple[float, float] = (0.0, 0.0)


class Statistics(msgspec.Struct, frozen=True):
    """Statistics of the displayed surface, answer to ``statistics``.

    rows, cols: size of the counted part, in points of `pixel_um`. n_heights: points with a height; n_points: those
    inside the clip; left_out: the others, by reason. Fractions refer to the points covered by fields. lowest, highest,
    mean, spread (one standard deviation): of the points inside the clip, None without any.

    ends_um, counts: histogram of all heights; the outermost bins include everything beyond. span_um: lowest and highest
    of all heights. block_px: side of the blocks whose mean heights are used if there are too many points, in points.
    refused: counts of refused points, if requested; n_heights and n_points do not include them.
    """

    rows: int
    cols: int
    pixel_um: float
    n_heights: int
    n_points: int
    measured_fraction: float
    filled_fraction: float
    unmeasured: tuple[tuple[str, float], ...]
    lowest_um: float | None
    highest_um: float | None
    mean_um: float | None
    spread_um: float | None
    left_out: dict[LeftOut, int] = {}
    ends_um: tuple[float, float] = (0.0, 0.0)
    counts: tuple[int, ...] = ()
    span_um: tuple[float, float] = (0.0, 0.0)
    block_px: int = 1
    brushed: Brushed | None = None
    refused: RefusedCounts | None = None


def pack_points(places_mm: NDArray[np.float16], colours: NDArray[np.uint8]) -> bytes:
    """Return the answer to ``points``: a count, float16 [n, 3] in mm from the window's middle, uint8 rgb [n, 3]."""
    return struct.pack("<I", len(places_mm)) + places_mm.astype("<f2").tobytes() + colours.tobytes()


def unpack_points(data: bytes) -> tuple[NDArray[np.float16], NDArray[np.uint8]]:
    """Return positions in mm from the window's middle, float16 [n, 3], and colours, uint8 [n, 3]."""
    n = struct.unpack_from("<I", data)[0]
    places = np.frombuffer(data, "<f2", 3 * n, 4).reshape(n, 3)
    return places, np.frombuffer(data, np.uint8, 3 * n, 4 + 6 * n).reshape(n, 3)
