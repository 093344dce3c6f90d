"""Summary of a stitched surface in numbers, for the page; stored as ``surface.json`` in its result."""

from __future__ import annotations

import msgspec
import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.surface.height_map import ORIGIN_TITLES, UNMEASURED_FROM, HeightMap, Mosaic, Origin
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.session.state.snapshot import SurfaceInfo
from wafer_viewer.store.dataset.result import Result
from wafer_viewer.store.io.atomic_files import write_text
from wafer_viewer.store.io.checksums import sealed_text, verified_text
from wafer_viewer.store.mosaic.layout import SURFACE
from wafer_viewer.store.mosaic.statistics import MosaicStatistics, compute_statistics
from wafer_viewer.store.mosaic.zarr_mosaic import ZarrMosaic

SUMMARY = "surface.json"
COLOUR_RANGE_PERCENT = (0.5, 99.5)
OUTLIERS_BEYOND = 3.0
"""Robust deviations beyond which an overlap difference counts as a false height, not as a misfit of fields."""
HALF_NORMAL_MEDIAN = 0.6745
"""Median of the absolute values of normal errors with standard deviation 1."""


def summarise(mosaic: Mosaic, n_fields: int, result: str, asked: Recipe | None = None) -> SurfaceInfo:
    """Return the summary of a mosaic of `n_fields` fields made with the recipe `asked`.

    The statistics stored with the mosaic are used; for a surface in memory they are computed. Fractions refer to the
    pixels covered by fields, so the area outside a round wafer does not count.
    """
    rows, cols = mosaic.shape
    facts = mosaic.facts() if isinstance(mosaic, ZarrMosaic) else _facts_of(mosaic.window())
    covered = max(1, int(facts.counts.sum() - facts.counts[Origin.NOT_COVERED]))
    low_um, high_um = _colour_range(facts.heights_um)
    return SurfaceInfo(
        result=result,
        stamp=0,
        rows=rows,
        cols=cols,
        pixel_um=mosaic.pixel_um,
        x0_um=mosaic.x0_um,
        y0_um=mosaic.y0_um,
        levels=mosaic.levels,
        n_fields=n_fields,
        highest_um=facts.highest_um if facts.has_heights else 0.0,
        lowest_um=facts.lowest_um if facts.has_heights else 0.0,
        measured_fraction=float(facts.counts[Origin.MEASURED]) / covered,
        filled_fraction=float(facts.counts[Origin.FILLED]) / covered,
        unmeasured=unmeasured_reasons(facts.counts, covered),
        overlap_rms_um=_rms_um(facts.overlaps_um),
        low_um=low_um,
        high_um=high_um,
        recipe_notes=mosaic.provenance.notes,
        asked=asked,
        settled=mosaic.provenance.recipe,
    )


def save_summary(result: Result, info: SurfaceInfo) -> None:
    """Write a summary next to its mosaic."""
    text = msgspec.json.format(msgspec.json.encode(info), indent=2).decode()
    write_text(result.path / SUMMARY, sealed_text(text))


def load_summary(result: Result) -> SurfaceInfo | None:
    """Return the stored summary; None if it is missing, damaged or of another version."""
    try:
        return msgspec.json.decode(verified_text(result.path / SUMMARY), type=SurfaceInfo)
    except (DatasetError, msgspec.DecodeError, UnicodeDecodeError):
        return None


def _facts_of(surface: HeightMap) -> MosaicStatistics:
    layers = {name: getattr(surface, name) for name in SURFACE if getattr(surface, name) is not None}
    return compute_statistics(layers)


def _rms_um(differences_um: NDArray[np.float32]) -> float | None:
    """Return the rms difference of neighbours in their overlaps, um; None without overlaps.

    Differences above the outlier limit, three robust deviations of normal errors, are excluded; the differences are
    never negative.
    """
    if not differences_um.size:
        return None
    limit_um = OUTLIERS_BEYOND * float(np.median(differences_um)) / HALF_NORMAL_MEDIAN
    near = differences_um[differences_um <= limit_um + 1e-6]
    return float(np.sqrt(np.mean(near**2)))


def _colour_range(heights_um: NDArray[np.float32]) -> tuple[float, float]:
    if not heights_um.size:
        return 0.0, 1.0
    low_um, high_um = np.percentile(heights_um, COLOUR_RANGE_PERCENT)
    return float(low_um), float(high_um)


def unmeasured_reasons(counts: NDArray[np.int64], covered: int) -> tuple[tuple[str, float], ...]:
    """Return the reasons for unmeasured covered pixels and their fractions, the most frequent first."""
    codes = [o for o in Origin if o >= UNMEASURED_FROM and o != Origin.NOT_COVERED and counts[o] > 0]
    return tuple((ORIGIN_TITLES[o], float(counts[o]) / covered) for o in sorted(codes, key=lambda o: -int(counts[o])))
