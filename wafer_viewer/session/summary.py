"""How a stitched surface looks, in numbers: what the page shows beside it. Kept as ``surface.json`` in its result."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

import msgspec
import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.recipe import Recipe
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface import ORIGIN_TITLES, UNMEASURED_FROM, HeightMap, Mosaic, Origin
from wafer_viewer.session.state import SurfaceInfo
from wafer_viewer.store.files import write_text
from wafer_viewer.store.result import Result

SUMMARY = "surface.json"
BLOCK_ROWS = 1024
SAMPLES = 400_000
"""Heights that the colour range is taken from."""
COLOUR_RANGE_PERCENT = (0.5, 99.5)
OUTLIERS_BEYOND = 3.0
"""Robust deviations beyond which a difference in an overlap is a false height, not a misfit of fields."""


def summarise(mosaic: Mosaic, heights: Sequence[HeightMap], result: str, asked: Recipe | None = None) -> SurfaceInfo:
    """Read a mosaic once, a block of rows at a time. `heights` are the fields it was made of, by the recipe `asked`."""
    rows, cols = mosaic.shape
    pixels = rows * cols
    counts = np.zeros(256, np.int64)
    samples: list[NDArray[np.float32]] = []
    extremes: list[tuple[float, float]] = []
    every = max(1, pixels // SAMPLES)
    for block in _blocks(mosaic):
        counts += np.bincount(block.origin.ravel(), minlength=256)
        known = block.z_um[np.isfinite(block.z_um)]
        samples.append(known[::every])
        if known.size:
            extremes.append((float(known.max()), float(known.min())))
    low_um, high_um = _colour_range(np.concatenate(samples))
    return SurfaceInfo(
        result=result,
        stamp=0,
        rows=rows,
        cols=cols,
        pixel_um=mosaic.pixel_um,
        x0_um=mosaic.x0_um,
        y0_um=mosaic.y0_um,
        levels=mosaic.levels,
        n_fields=len(heights),
        highest_um=max((high for high, _ in extremes), default=0.0),
        lowest_um=min((low for _, low in extremes), default=0.0),
        measured_fraction=float(counts[Origin.MEASURED]) / pixels,
        filled_fraction=float(counts[Origin.FILLED]) / pixels,
        unmeasured=_reasons(counts),
        overlap_rms_um=overlap_rms_um(heights),
        low_um=low_um,
        high_um=high_um,
        recipe_notes=mosaic.provenance.notes,
        asked=asked,
        settled=mosaic.provenance.recipe,
    )


def overlap_rms_um(heights: Sequence[HeightMap]) -> float | None:
    """How well neighbours agree where they overlap: the rms of their differences, pixel on nearest pixel.

    Differences beyond three robust deviations are left out. None when no two fields overlap.
    """
    pairs = (_differences(a, b) for a, b in combinations(heights, 2))
    found = [d for d in pairs if d.size]
    if not found:
        return None
    differences = np.concatenate(found)
    off = np.abs(differences - np.median(differences))
    near = differences[off <= OUTLIERS_BEYOND * 1.4826 * np.median(off) + 1e-6]
    return float(np.sqrt(np.mean(near**2))) if near.size else 0.0


def save_summary(result: Result, info: SurfaceInfo) -> None:
    """Keep a summary beside its mosaic."""
    write_text(result.path / SUMMARY, msgspec.json.encode(info).decode())


def load_summary(result: Result) -> SurfaceInfo | None:
    """The kept summary; None when there is none, or one of another version."""
    try:
        return msgspec.json.decode((result.path / SUMMARY).read_bytes(), type=SurfaceInfo)
    except (OSError, msgspec.DecodeError):
        return None


def _blocks(mosaic: Mosaic) -> Iterator[HeightMap]:
    rows, cols = mosaic.shape
    right_um = mosaic.x0_um + (cols - 1) * mosaic.pixel_um
    for top in range(0, rows, BLOCK_ROWS):
        bottom = min(rows, top + BLOCK_ROWS) - 1
        y_top_um, y_bottom_um = (mosaic.y0_um - row * mosaic.pixel_um for row in (top, bottom))
        yield mosaic.window(Region.rectangle(mosaic.x0_um, y_bottom_um, right_um, y_top_um))


def _colour_range(heights_um: NDArray[np.float32]) -> tuple[float, float]:
    if not heights_um.size:
        return 0.0, 1.0
    low_um, high_um = np.percentile(heights_um, COLOUR_RANGE_PERCENT)
    return float(low_um), float(high_um)


def _reasons(counts: NDArray[np.int64]) -> tuple[tuple[str, float], ...]:
    """Why pixels are unmeasured, the most frequent reason first."""
    reasons = [(ORIGIN_TITLES[o], float(counts[o]) / float(counts.sum())) for o in Origin if o >= UNMEASURED_FROM]
    return tuple(sorted(((title, share) for title, share in reasons if share > 0), key=lambda r: -r[1]))


def _differences(a: HeightMap, b: HeightMap) -> NDArray[np.float32]:
    """Heights of `a` minus those of `b` where both measured, `b` shifted by whole pixels."""
    down, right = round((a.y0_um - b.y0_um) / a.pixel_um), round((b.x0_um - a.x0_um) / a.pixel_um)
    rows_a, rows_b = _shared(a.shape[0], b.shape[0], down)
    cols_a, cols_b = _shared(a.shape[1], b.shape[1], right)
    difference = a.z_raw_um[rows_a, cols_a] - b.z_raw_um[rows_b, cols_b]
    return difference[np.isfinite(difference)]


def _shared(n_a: int, n_b: int, shift: int) -> tuple[slice, slice]:
    """Where two runs of pixels overlap, the second beginning `shift` after the first; in the numbers of each."""
    first, last = max(0, shift), max(max(0, shift), min(n_a, n_b + shift))
    return slice(first, last), slice(first - shift, last - shift)
