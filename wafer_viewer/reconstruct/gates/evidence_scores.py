"""Scores of heights as evidence: of the focus curve, of the neighbours among the accepted heights, and of their light.

All are in units of the noise, of the optics or of the window, so that they mean the same on other samples. Scores of
the neighbourhood are those of cells of 4 x 4 pixels.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.calibration import WAVELENGTH_UM
from wafer_viewer.model.surface.height_map import Origin
from wafer_viewer.numerics.filters.interpolation import local_planes
from wafer_viewer.numerics.filters.regions import component_sizes
from wafer_viewer.numerics.filters.sliding_filters import highest, lowest, mean, repeated
from wafer_viewer.numerics.jit import Float32s, Int, Real, UInt8s, inline_kernel, lean_kernel, lean_part
from wafer_viewer.reconstruct.focus.focus_volume import COARSE_PX
from wafer_viewer.reconstruct.focus.peak import Peaks
from wafer_viewer.reconstruct.focus.peak_search import FOCUS_WIDTH_DEPTHS
from wafer_viewer.reconstruct.gates.edge_sides import cell_means, cell_medians
from wafer_viewer.reconstruct.gates.gate import CLIPPED_FRAMES_FRACTION, GateTest
from wafer_viewer.reconstruct.gates.mirrored_light import Symmetry, around_cells
from wafer_viewer.reconstruct.gates.silhouettes import DARK_SHARE_OF_WHITE

PIXEL_SCORES: dict[str, Origin] = {
    "contrast": Origin.NO_TEXTURE,
    "lead": Origin.AMBIGUOUS,
    "fall": Origin.AMBIGUOUS,
    "fall share": Origin.AMBIGUOUS,
    "windows": Origin.WINDOWS_DISAGREE,
    "clipped": Origin.CLIPPED,
    "range": Origin.END_OF_RANGE,
    "side": Origin.BLEEDING_EDGE,
    "off plane": Origin.OUTLIER,
    "off wide plane": Origin.OUTLIER,
    "off cell": Origin.OUTLIER,
    "border": Origin.OUTLIER,
}
"""Scores of pixels, with the reason that they give.

contrast, lead, fall: over what noise reaches, powers of two; fall share: of the contrast; windows: difference to the
height of a wider window, resolutions; clipped: share of the window; range: distance to the nearer end of the sweep,
focus widths; side: code of `EdgeSide`; off plane, off wide plane, off cell: distance to the plane of the accepted
heights within two and four windows and to the median of the cell, resolutions; border: distance to that of the frame,
windows.
"""

CELL_SCORES: dict[str, Origin] = {
    "clipped around": Origin.CLIPPED,
    "accepted": Origin.OUTLIER,
    "accepted around": Origin.OUTLIER,
    "accepted far": Origin.OUTLIER,
    "bleeding far": Origin.BLEEDING_EDGE,
    "slope": Origin.STEP_EDGE,
    "slope around": Origin.STEP_EDGE,
    "rough far": Origin.STEP_EDGE,
    "agree": Origin.OUTLIER,
    "agree around": Origin.OUTLIER,
    "agree far": Origin.OUTLIER,
    "brighter in the cone": Origin.BLEEDING_EDGE,
    "its height": Origin.BLEEDING_EDGE,
    "brighter": Origin.BLEEDING_EDGE,
    "darker": Origin.BLEEDING_EDGE,
    "size": Origin.OUTLIER,
    "accepted size": Origin.OUTLIER,
    "width": Origin.AMBIGUOUS,
    "asymmetry": Origin.BLEEDING_EDGE,
    "sure asymmetry": Origin.BLEEDING_EDGE,
    "sure symmetry": Origin.NO_TEXTURE,
}
"""Scores of cells, with the reason that they give; around: within two windows, far: within four or `FAR_CELLS`.

clipped, accepted, bleeding: shares of pixels; slope: of planes through the accepted heights, cones of light, and rough,
their root mean square distance, resolutions; agree: share of accepted cells within a resolution; brighter in the cone:
largest logarithm of brightness over the cell, of accepted cells at another height whose cone of light reaches it, and
that other height, resolutions; brighter, darker: over all cells within two windows; size: logarithm of the area of the
connected heights, and of the accepted ones, windows squared; width: of focus curves, steps; asymmetry: of the light
about the height, relative to its symmetry, and both in standard deviations of their noise.
"""

FAR_CELLS = 33
"""Side of the largest square whose heights count, in cells."""
_LARGEST = np.float32(1e3)
"""Magnitude of the largest score."""
_MOST_ASYMMETRIC, _SURE, _LEAST = np.float32(2), np.float32(300), np.float32(1e-6)
"""Largest asymmetry, relative and in standard deviations, and the smallest denominator of either."""
_UNKNOWN = np.float32(-1)
"""Score that is not known: without a wider window, or a plane."""
_ALONE = np.float32(-4)
"""Size of cells without accepted heights."""
_NOWHERE_UM = np.float32(1e6)
"""Height of a cell without peaks, away from all others."""
CONNECTED = 1.5
"""Largest difference of connected cells of accepted heights, in resolutions."""


@dataclass(frozen=True, slots=True)
class Units:
    """Units of the scores of a field: window in px, resolution, focus width, pixel and step, and z of the frames.

    clipped_counts: grey from which pixels are too bright.
    """

    window: int
    resolution_um: float
    focus_width_um: float
    pixel_um: float
    step_um: float
    z_um: NDArray[np.float64]
    clipped_counts: float

    @property
    def cone(self) -> float:
        """Slope of the cone of light: the root of the depth of field, lambda / NA^2, in wavelengths.

        This holds for small apertures.
        """
        return math.sqrt(self.focus_width_um / FOCUS_WIDTH_DEPTHS / WAVELENGTH_UM)


class Scores(NamedTuple):
    """Scores of rows of pixels, when asked for [score, row, col], and those of all cells [score, row / 4, col / 4]."""

    of_pixels: Callable[[slice], Float32s]
    cells: Float32s

    def planes(self, shape: tuple[int, int]) -> Float32s:
        """Return all scores of all pixels of a field [score, row, col]."""
        pixels = self.of_pixels(slice(0, shape[0]))
        return np.concatenate([pixels, [repeated(cells, COARSE_PX, shape) for cells in self.cells]])


def scores_of(
    peaks: Peaks,
    tests: tuple[GateTest, ...],
    z_um: NDArray[np.float32],
    accepted: NDArray[np.bool_],
    bleeding: NDArray[np.bool_],
    side: NDArray[np.uint8] | None,
    mirror: Symmetry,
    units: Units,
) -> Scores:
    """Return the scores of heights, z_um [row, col]; accepted: mask of those that vouch for others.

    tests: of the gates; bleeding: mask of heights that light from over a wall made; side: codes of `EdgeSide`, None
    where there are no walls; mirror: symmetry of the light about the heights of the cells.
    """
    by_name = {test.name: test for test in tests}
    shape, window, resolution = z_um.shape, units.window, np.float32(units.resolution_um)
    n_cells = -(-shape[0] // COARSE_PX), -(-shape[1] // COARSE_PX)

    def share(mask: NDArray[np.bool_]) -> NDArray[np.float32]:
        return cell_means(mask.view(np.uint8), n_cells)

    around, far = (window // 2) | 1, window | 1
    accepted_share = share(accepted)
    any_um = cell_medians(z_um, ~peaks.at_end, np.ones(n_cells, np.bool_))
    seeds_um = np.where(accepted_share == 1, any_um, np.float32(np.nan))
    mixed = (accepted_share > 0) & (accepted_share < 1)
    np.copyto(seeds_um, cell_medians(z_um, accepted, mixed), where=mixed)
    near, middle, wide = (local_planes(seeds_um, size) for size in (3, around, far))
    cone_px = np.float32(units.cone * COARSE_PX * units.pixel_um)
    grey = np.log(cell_means(peaks.all_in_focus, n_cells) + np.float32(DARK_SHARE_OF_WHITE * units.clipped_counts))
    beside = np.zeros((5, *n_cells), np.float32)
    own_um = np.where(np.isnan(any_um), _NOWHERE_UM, any_um)
    reach = 1, window // COARSE_PX + 1, window // 2 + 1
    per_um = 1 / (units.cone * units.pixel_um)
    counts = np.empty((6, n_cells[1]), np.float32)
    compare_cells(own_um, seeds_um, grey, reach, units.resolution_um, per_um, window / 2, counts, beside)
    too_bright = share(peaks.clipped >= max(1, round(CLIPPED_FRAMES_FRACTION * len(units.z_um))))
    area = np.float32(COARSE_PX**2 / window**2)
    connected = np.log2(component_sizes(any_um, resolution) * area)
    joined = np.log2(component_sizes(seeds_um, np.float32(CONNECTED * units.resolution_um)) * area)
    cells = (
        mean(too_bright, far),
        mean(accepted_share, 3),
        mean(accepted_share, around),
        mean(accepted_share, FAR_CELLS),
        mean(share(bleeding), FAR_CELLS),
        near.gradient / cone_px,
        middle.gradient / cone_px,
        wide.residual / resolution,
        *beside,
        highest(grey, around) - grey,
        grey - lowest(grey, around),
        connected,
        np.where(np.isnan(seeds_um), _ALONE, joined),
        np.full(n_cells, units.focus_width_um / units.step_um),
        *_symmetry_scores(around_cells(mirror)),
    )
    compared = by_name["windows"].score if "windows" in by_name else np.full((1, 1), np.float32(-resolution))
    limits = np.array(
        [*(max(by_name[name].limit, 0.0) for name in ("texture", "rival", "flanks")), resolution, *units.z_um[[0, -1]],
         units.focus_width_um, window],
        np.float32,
    )  # fmt: skip
    side_code = np.zeros((1, 1), np.uint8) if side is None else side
    planes = (peaks.contrast, peaks.lead, peaks.fall, by_name["clipped"].score, z_um, compared)

    near_um = np.stack((middle.height, wide.height, own_um)).astype(np.float32, copy=False)

    def of_pixels(rows: slice) -> Float32s:
        out = np.empty((len(PIXEL_SCORES), rows.stop - rows.start, shape[1]), np.float32)
        _score_pixels(planes, side_code, near_um, limits, rows.start, shape[0], out)
        return out

    return Scores(of_pixels, _finite(cells))


@lean_kernel
def _score_pixels(
    planes: tuple[Float32s, ...],
    side: UInt8s,
    near_um: Float32s,
    limits: Float32s,
    first: Int,
    n_rows: Int,
    out: Float32s,
) -> None:
    """Write the scores of the rows from `first` on, of `n_rows`, in the order of `PIXEL_SCORES`, within `_LARGEST`.

    A plane of windows or of sides that nobody compared is a single value.
    """
    contrast, lead, fall, clipped, z_um, windows = planes
    resolution, window = limits[3], limits[7]
    is_compared, has_sides, zero = windows.size > 1, side.size > 1, np.float32(0)
    for row in range(out.shape[1]):
        y = first + row
        _subtract(contrast[y], limits[0], out[0, row])
        _subtract(lead[y], limits[1], out[1, row])
        _subtract(fall[y], limits[2], out[2, row])
        _divide(fall[y], contrast[y], out[3, row])
        _scale(windows[y if is_compared else 0], resolution, out[4, row])
        _subtract(clipped[y], zero, out[5, row])
        _from_ends(z_um[y], limits[4:7], out[6, row])
        _take_codes(side[y if has_sides else 0], out[7, row])
        for k in range(3):
            _from_cells(z_um[y], near_um[k, y // COARSE_PX], resolution, out[8 + k, row])
        _from_border(np.float32(min(y, n_rows - 1 - y)), window, out[11, row])


@inline_kernel
def _bounded(score: Any) -> Any:
    """Return a score within `_LARGEST`, -1 where it is not known."""
    known = score if score == score else _UNKNOWN
    return min(max(known, -_LARGEST), _LARGEST)


@lean_part
def _subtract(values: Any, limit: Any, out: Any) -> None:
    for x in range(out.size):
        out[x] = _bounded(values[x] - limit)


@lean_part
def _divide(values: Any, others: Any, out: Any) -> None:
    for x in range(out.size):
        out[x] = _bounded(values[x] / max(others[x], _LEAST))


@lean_part
def _scale(values: Any, unit: Any, out: Any) -> None:
    """Divide values by a unit; a single value stands for all."""
    step = np.int64(values.size > 1)
    for x in range(out.size):
        out[x] = _bounded(values[step * x] / unit)


@lean_part
def _from_ends(z_um: Any, limits: Any, out: Any) -> None:
    low_um, high_um, width_um = limits
    for x in range(out.size):
        out[x] = _bounded(min(z_um[x] - low_um, high_um - z_um[x]) / width_um)


@lean_part
def _take_codes(codes: Any, out: Any) -> None:
    step = np.int64(codes.size > 1)
    for x in range(out.size):
        out[x] = np.float32(codes[step * x])


@lean_part
def _from_cells(z_um: Any, cells_um: Any, unit: Any, out: Any) -> None:
    for x in range(out.size):
        out[x] = _bounded(abs(z_um[x] - cells_um[x // COARSE_PX]) / unit)


@lean_part
def _from_border(away: Any, window: Any, out: Any) -> None:
    for x in range(out.size):
        out[x] = min(away, np.float32(min(x, out.size - 1 - x))) / window


def _symmetry_scores(mirror: Symmetry) -> Iterator[NDArray[Any]]:
    sigma = np.sqrt(np.maximum(mirror.variance, _LEAST))
    yield np.clip(mirror.asymmetry / np.maximum(mirror.symmetry, _LEAST), 0, _MOST_ASYMMETRIC)
    yield np.minimum(mirror.asymmetry / sigma, _SURE)
    yield mirror.symmetry / sigma


def _finite(planes: tuple[NDArray[Any], ...]) -> Float32s:
    """Return planes of scores, -1 where they are not known, within `_LARGEST`."""
    out = np.empty((len(planes), *planes[0].shape), np.float32)
    for number, plane in enumerate(planes):
        found: Float32s = out[number, :]
        found[:] = plane
        np.copyto(found, _UNKNOWN, where=np.isnan(found))
        np.clip(found, -_LARGEST, _LARGEST, out=found)
    return out


@lean_kernel
def compare_cells(
    own_um: Float32s,
    seeds_um: Float32s,
    grey: Float32s,
    reach: tuple[Int, Int, Int],
    tolerance_um: Real,
    px_per_um: Real,
    base_px: Real,
    counts: Float32s,
    out: Float32s,
) -> None:
    """Compare the height and the light of each cell with the accepted ones around it.

    out [5, i, j]: the shares that agree within three reaches, the largest brightness over the cell among those at
    another height whose cone of light reaches it, and how far that height is, in tolerances. px_per_um: how fast the
    cone widens; base_px: its reach in focus; counts: work memory, six rows of cells.
    """
    rows, cols = own_um.shape
    far = reach[2]
    count, agree = counts[:3], counts[3:]
    tolerance, per_um, base = np.float32(tolerance_um), np.float32(px_per_um), np.float32(base_px)
    for i in range(rows):
        counts[:] = 0
        brighter, off = out[3, i], out[4, i]
        brighter[:], off[:] = 0, 0
        own, own_grey = own_um[i], grey[i]
        for r in range(max(0, i - far), min(rows, i + far + 1)):
            for shift in range(-min(far, cols - 1), min(far, cols - 1) + 1):
                apart = max(abs(r - i), abs(shift))
                here, there = slice(max(0, -shift), cols - max(0, shift)), slice(max(0, shift), cols + min(0, shift))
                for k in range(3):
                    if apart <= reach[k]:
                        _count_alike(own[here], seeds_um[r, there], tolerance, count[k, here], agree[k, here])
                away = np.float32(COARSE_PX * math.sqrt((r - i) ** 2 + shift**2))
                cone = tolerance, per_um, base - away
                lights = own_grey[here], grey[r, there]
                _find_brighter(own[here], seeds_um[r, there], lights, cone, brighter[here], off[here])
        for k in range(3):
            for j in range(cols):
                out[k, i, j] = agree[k, j] / max(count[k, j], np.float32(1))


@lean_part
def _count_alike(own_um: Any, others_um: Any, tolerance: Any, count: Any, agree: Any) -> None:
    for x in range(own_um.size):
        off_um = abs(others_um[x] - own_um[x])
        agree[x] += np.float32(1) if off_um <= tolerance else np.float32(0)
        count[x] += np.float32(1) if off_um == off_um else np.float32(0)


@lean_part
def _find_brighter(own_um: Any, others_um: Any, lights: Any, cone: Any, brighter: Any, off: Any) -> None:
    own_grey, greys = lights
    tolerance, per_um, spare = cone
    for x in range(own_um.size):
        off_um = abs(others_um[x] - own_um[x])
        over = greys[x] - own_grey[x]
        found = (off_um > tolerance) & (over > brighter[x]) & (off_um * per_um + spare >= np.float32(0))
        brighter[x] = over if found else brighter[x]
        off[x] = off_um / tolerance if found else off[x]
