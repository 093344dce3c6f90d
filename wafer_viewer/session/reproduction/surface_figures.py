"""Figures of a stitched surface for the paper's tables, with a picture and cuts of it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.tools.flatness import flatness
from wafer_viewer.measure.tools.step_height import step_height
from wafer_viewer.measure.truth_comparison import quality, squared_bending
from wafer_viewer.model.errors import DatasetError, MeasureError, WaferViewerError
from wafer_viewer.model.progress import Progress
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import Spec
from wafer_viewer.model.surface.height_map import HasLayers, HeightLayer, HeightMap, Mosaic
from wafer_viewer.session.reproduction.paper_samples import Z_STEP_UM, PaperSample

ROWS_AT_ONCE = 256
"""Rows of a mosaic that are in memory at once."""
PICTURE_PX, CUT_POINTS = 420, 1500
"""Most pixels of a side of a picture, and most points of a cut; others are left out: averages would hide noise."""
ROWS_OF_THE_PAPER = (1000, 3500, 6000)
SHARES_OF_THE_PAPER = (1 / 7, 1 / 2, 6 / 7)
"""Rows that the paper cuts at, and the same as fractions of the height of its mosaic."""
FLOAT = np.float32
Heights = NDArray[np.float32]


class SurfaceFigures(Spec, frozen=True, kw_only=True):
    """Figures of a surface by quantity, the reason for each that could not be measured, and the titles of its cuts."""

    error: ClassVar[type[WaferViewerError]] = DatasetError
    values: dict[str, float] = msgspec.field(default_factory=dict[str, float])
    problems: dict[str, str] = msgspec.field(default_factory=dict[str, str])
    cuts: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Cut:
    """Row of a mosaic that is cut: its title and its number."""

    title: str
    row: int


def cuts_of(sample: PaperSample, surface: Mosaic) -> tuple[Cut, ...]:
    """Return the rows of the paper by number, as far as the mosaic has them, and by share of its height.

    The middle one of the latter lies in the gel drop.
    """
    n_rows = surface.shape[0]
    by_number = (Cut(f"row {row}", row) for row in ROWS_OF_THE_PAPER if row < n_rows)
    shares = [Cut(f"{share:.3f} of the height", round(share * n_rows)) for share in SHARES_OF_THE_PAPER]
    if sample.drop_um is not None:
        shares[1] = Cut("through the gel drop", round((surface.y0_um - sample.drop_um[1]) / surface.pixel_um))
    return *by_number, *shares


def figures_of(sample: PaperSample, surface: Mosaic, tell: Progress) -> tuple[SurfaceFigures, dict[str, Heights]]:
    """Return the figures of a surface, and arrays: ``map``, ``map_measured``, and each cut with its true heights."""
    values: dict[str, float] = {}
    problems: dict[str, str] = {}
    arrays = _scan_rows(surface, values, tell)
    cuts = cuts_of(sample, surface) if sample.drop_um is not None else ()
    for n, cut in enumerate(cuts):
        arrays |= _cut(sample, surface, cut.row, n, values)
    if sample.face_px:
        _measure_blocks(sample, surface, values, problems)
    if sample.name == "stair":
        values |= _against_truth(sample, surface)
    plain = {name: float(value) for name, value in values.items()}
    return SurfaceFigures(values=plain, problems=problems, cuts=tuple(cut.title for cut in cuts)), arrays


def _scan_rows(surface: Mosaic, values: dict[str, float], tell: Progress) -> dict[str, Heights]:
    """Add smoothness and share of the heights to the values; return every n-th pixel of them."""
    n_rows, n_cols = surface.shape
    every = math.ceil(max(n_rows, n_cols) / PICTURE_PX)
    pictures: dict[str, list[Heights]] = {"map": [], "map_measured": []}
    bending = finite = measured = 0.0
    for first, end in _bands(n_rows):
        z_um = _rows(surface, "filled", max(0, first - 1), min(n_rows, end + 1))
        squares = squared_bending(z_um)
        bending, finite = bending + float(squares.sum()), finite + squares.size
        own = z_um[min(first, 1) :][: end - first]
        raw_um = _rows(surface, "unsmoothed", first, end)
        measured += np.isfinite(raw_um).sum()
        start = -first % every
        pictures["map"].append(own[start::every, ::every])
        pictures["map_measured"].append(raw_um[start::every, ::every])
        tell(end / n_rows)
    values["ssm_um2"] = bending / finite if finite else math.nan
    values["measured_fraction"] = float(measured) / (n_rows * n_cols)
    values["picture_um"] = every * surface.pixel_um
    return {name: np.concatenate(parts) for name, parts in pictures.items()}


def _bands(n_rows: int) -> Iterator[tuple[int, int]]:
    return ((first, min(n_rows, first + ROWS_AT_ONCE)) for first in range(0, n_rows, ROWS_AT_ONCE))


def _rows(surface: Mosaic, layer: HeightLayer, first: int, end: int) -> Heights:
    """Return rows [first, end) of a layer of heights."""
    inset = surface.pixel_um / 4
    high_um, low_um = surface.y0_um - first * surface.pixel_um, surface.y0_um - (end - 1) * surface.pixel_um
    right_um = surface.x0_um + (surface.shape[1] - 1) * surface.pixel_um
    region = Region.rectangle(surface.x0_um - inset, low_um - inset, right_um + inset, high_um + inset)
    if isinstance(surface, HasLayers):
        return surface.one_layer(layer, region).z_um
    part = surface.window(region)
    return part.z_raw_um if layer == "unsmoothed" else part.z_um


def _cut(sample: PaperSample, surface: Mosaic, row: int, n: int, values: dict[str, float]) -> dict[str, Heights]:
    """Return a cut and the true heights along it; add the shares of measured and of false heights to the values."""
    z_um = _rows(surface, "filled", row, row + 1)[0]
    x_um = surface.x0_um + surface.pixel_um * np.arange(z_um.size)
    true_um = sample.scene.truth(x_um, np.full(z_um.size, surface.y0_um - row * surface.pixel_um))
    known = np.isfinite(z_um)
    values[f"cut{n}_fraction"] = float(known.mean())
    values[f"cut{n}_false_fraction"] = (
        float((np.abs(z_um - true_um)[known] > Z_STEP_UM).mean()) if known.any() else math.nan
    )
    every = math.ceil(z_um.size / CUT_POINTS)
    return {f"x{n}": x_um[::every].astype(FLOAT), f"cut{n}": z_um[::every], f"true{n}": true_um[::every]}


def _measure_blocks(sample: PaperSample, surface: Mosaic, values: dict[str, float], problems: dict[str, str]) -> None:
    """Add the height between both areas, its error, U and the flatness of the areas to the values."""
    upper, lower = sample.faces
    try:
        found = step_height(surface, upper, lower).height
        values["height_um"], values["height_u_um"] = found.value_um, found.expanded_um or math.nan
        values["true_height_um"] = _true_height_um(sample, surface)
        values["height_error_um"] = abs(found.value_um - values["true_height_um"])
        flats = [flatness(surface, face) for face in (upper, lower)]
        values["flatness_um"] = float(np.mean([flat.flt_t.value_um for flat in flats]))
        values["flatness_rms_um"] = float(np.mean([flat.flt_q.value_um for flat in flats]))
    except MeasureError as fault:
        problems["height_um"] = str(fault)


def _true_height_um(sample: PaperSample, surface: Mosaic) -> float:
    """Return the same measurement on the true heights of both areas; the blocks are tilted by 0.3 mrad."""
    upper, lower = sample.faces
    (x0, y0, _, _), (_, _, x1, y1) = upper.bounds_um, lower.bounds_um
    step_um = max(surface.pixel_um, (x1 - x0) / PICTURE_PX)
    x_um, y_um = np.arange(x0, x1 + step_um, step_um), np.arange(y1, y0 - step_um, -step_um)
    z_um = sample.scene.truth(*np.meshgrid(x_um, y_um))
    empty: Any = np.zeros(z_um.shape, np.uint8)
    true = HeightMap(z_um, z_um, np.ones_like(z_um), empty, empty, step_um, x0, y1)
    return step_height(true, upper, lower).height.value_um


def _against_truth(sample: PaperSample, surface: Mosaic) -> dict[str, float]:
    """Return eq. 17 and 18, the PSNR by the range of the truth, and the shares of known and of false heights."""
    rows, cols = surface.shape
    x_um = surface.x0_um + surface.pixel_um * np.arange(cols)
    y_um = surface.y0_um - surface.pixel_um * np.arange(rows)
    true_um = sample.scene.truth(*np.meshgrid(x_um, y_um))
    found = quality(_rows(surface, "filled", 0, rows), true_um, Z_STEP_UM)
    return {
        "rmse_um": found.rmse_um,
        "corr": found.corr,
        "psnr_db": found.psnr_db,
        "heights_fraction": found.completeness_fraction,
        "false_fraction": found.false_fraction,
    }
