"""Our image operations and robust fits beside those of scikit-image, on the same data.

    python tests/bench/image_peers.py [--quick]

Per row: milliseconds of ours and of scikit-image, medians of runs in turn, their ratio, and how far the results agree.
Scores are noise of deviation 1 with planted defects; heights are three levels with a third unmeasured; edge points
have noise of 0.03 to 0.6 px, which nobody tells the fits, and a tenth of outliers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from scipy import ndimage
from skimage.filters import apply_hysteresis_threshold
from skimage.measure import CircleModel, LineModelND, label, ransac, regionprops_table
from skimage.morphology import dilation, footprint_rectangle, reconstruction, remove_small_objects

from tests.bench.harness import read_options, took
from tests.support.made_up_pictures import disc, strip
from wafer_viewer.measure.base.robust_fit import fit_line
from wafer_viewer.measure.defects.features import ellipse_of
from wafer_viewer.measure.tools.circle import CIRCLE_SEARCH, Ring, find_circle, fit_ring
from wafer_viewer.numerics.filters.regions import (
    component_sizes,
    dilated,
    region_maxima,
    regions_with_peaks,
)

RUNS = 9
HIGH, LOW = 5.0, 3.0
"""Thresholds of scores in deviations."""
REACH_PX, LEAST_PX = 4, 81
LEVEL_UM, STEP_UM = 10.0, 1.0
"""Distance of the levels, and the largest step within one component."""
RADIUS_PX, SLOPE, SEEDS = 60.0, 0.02, 5
AROUND = np.ones((3, 3), int)


class Case(NamedTuple):
    """Two functions that do the same, and the sentence on their results."""

    name: str
    ours: Callable[[], object]
    theirs: Callable[[], object]
    agreement: Callable[..., str]


def main() -> None:
    side = 640 if read_options(__doc__).quick else 2048
    print(f"{side} x {side} pixels\n{'':44} {'ours ms':>8} {'theirs ms':>9} {'ratio':>6}  agreement")
    for case in (*of_scores(side), *of_heights(side), *of_defects(side), *of_edges()):
        results = case.ours(), case.theirs()
        ours, theirs = medians_ms(case.ours, case.theirs)
        print(f"{case.name:44} {ours:8.2f} {theirs:9.2f} {theirs / ours:6.1f}  {case.agreement(*results)}", flush=True)


def medians_ms(*functions: Callable[[], object]) -> list[float]:
    spent = [[took(function).clock_s for function in functions] for _ in range(RUNS)]
    return (1e3 * np.median(spent, axis=0)).tolist()


def same_pixels(ours: np.ndarray, theirs: np.ndarray) -> str:
    differ = int(np.count_nonzero(ours != theirs))
    return f"{differ} of {np.count_nonzero(ours)} pixels differ" if differ else "bit for bit"


def of_scores(side: int) -> Iterator[Case]:
    plane = scores(side)
    low, peaks = plane >= LOW, plane >= HIGH
    square = footprint_rectangle((2 * REACH_PX + 1,) * 2)

    def labelled() -> np.ndarray:
        labels = label(low, connectivity=2)
        return low & np.isin(labels, np.unique(labels[peaks]))

    def maxima() -> np.ndarray:
        return regionprops_table(label(low, connectivity=2), plane, properties=("intensity_max",))["intensity_max"]

    def ours() -> np.ndarray:
        return regions_with_peaks(low, peaks)

    plain = np.nextafter(np.float32(LOW), 0), np.nextafter(np.float32(HIGH), 0)  # theirs begin over a threshold
    yield Case("apply_hysteresis_threshold", ours, lambda: apply_hysteresis_threshold(plane, *plain), same_pixels)
    yield Case("reconstruction", ours, lambda: reconstruction(peaks, low, footprint=AROUND).astype(bool), same_pixels)
    yield Case("label, then those with peaks", ours, labelled, same_pixels)
    yield Case("label and regionprops_table, maxima", lambda: region_maxima(plane, LOW), maxima, same_pixels)
    yield Case("dilation, square", lambda: dilated(low, REACH_PX), lambda: dilation(low, square), same_pixels)


def of_heights(side: int) -> Iterator[Case]:
    z_um = heights(side)
    known = np.isfinite(z_um)

    def objects() -> np.ndarray:
        return known & ~remove_small_objects(known, max_size=LEAST_PX - 1)

    def by_scipy() -> np.ndarray:
        labels = np.asarray(ndimage.label(known)[0], np.intp)
        sizes = np.bincount(labels.ravel())
        sizes[0] = 0
        return known & (sizes[labels] < LEAST_PX)

    for words, step_um in (("a step parts", STEP_UM), ("no step parts", np.inf)):
        components = (lambda step: lambda: known & (component_sizes(z_um, step) < LEAST_PX))(step_um)
        yield Case(f"remove_small_objects, {words}", components, objects, same_pixels)
    yield Case("remove_small_objects beside SciPy's label", by_scipy, objects, same_pixels)


def of_defects(side: int) -> Iterator[Case]:
    labels = label(scores(side) >= LOW, connectivity=2)
    boxes = ndimage.find_objects(labels)
    large = [k for k, size in enumerate(np.bincount(labels.ravel())) if k and size >= 9]
    labels[~np.isin(labels, large)] = 0
    wanted = "centroid", "axis_major_length", "axis_minor_length", "orientation", "area"

    def ours() -> np.ndarray:
        found = []
        for k in large:
            rows, cols = boxes[k - 1]
            r, c = (n.astype(float) for n in np.nonzero(labels[rows, cols] == k))
            found.append(ellipse_of(c, r, np.ones(len(r)), 1.0).major_um)
        return np.array(found)

    def theirs() -> np.ndarray:
        return regionprops_table(labels, properties=wanted)["axis_major_length"]

    yield Case(f"regionprops_table, {len(large)} ellipses", ours, theirs, of_axes)


def of_axes(ours: np.ndarray, theirs: np.ndarray) -> str:
    points = np.sqrt(np.maximum(ours**2 - 16 / 12, 0))  # a pixel has an extent with us, theirs is a point
    return f"major axes {np.abs(theirs - ours).max():.2f} px apart, as points {np.abs(theirs - points).max():.0e} px"


def of_edges() -> Iterator[Case]:
    pictures = [strip(disc(RADIUS_PX, *shift, side=200, seed=k)) for k, shift in enumerate(shifts())]
    some, many, lines = ([make(k) for k in range(SEEDS)] for make in (circle, few_on_circle, line))
    start, draws = Ring(1.0, -1.0, RADIUS_PX + 2), CIRCLE_SEARCH.draws

    def consensus(points: np.ndarray, threshold: float, most: int) -> float:
        return ransac(points, CircleModel, 3, threshold, max_trials=most, rng=1)[0].radius

    def slope(direction: tuple[float, float]) -> float:
        return direction[1] / direction[0]

    yield Case(
        f"ransac, circle in a picture, {draws} draws",
        each(pictures, lambda one: find_circle(one, 0.0, 0.0, 1.3 * RADIUS_PX).radius_um),
        each(many, lambda points: consensus(points, CIRCLE_SEARCH.near_px, draws)),
        errors_from(RADIUS_PX, "px"),
    )
    for name, theirs in (
        ("ransac, circle, 100 draws", lambda points: consensus(points, 0.3, 100)),
        ("CircleModel", lambda points: CircleModel.from_estimate(points).radius),
    ):
        ours = each(some, lambda points: fit_ring(points[:, 1], points[:, 0], start)[0].radius)
        yield Case(name, ours, each(some, theirs), errors_from(RADIUS_PX, "px"))
    for name, theirs in (
        ("ransac, line, 100 draws", lambda points: ransac(points, LineModelND, 2, 0.3, max_trials=100, rng=1)[0]),
        ("LineModelND", LineModelND.from_estimate),
    ):
        ours = each(lines, lambda points: slope(fit_line(*points.T).direction))
        their_slope = (lambda fit: lambda points: slope(fit(points).direction))(theirs)
        yield Case(name, ours, each(lines, their_slope), errors_from(SLOPE, "rad"))


def each(data: list, function: Callable[..., float]) -> Callable[[], np.ndarray]:
    return lambda: np.array([function(one) for one in data])


def errors_from(true: float, unit: str) -> Callable[[np.ndarray, np.ndarray], str]:
    def words(ours: np.ndarray, theirs: np.ndarray) -> str:
        rms = (float(np.sqrt(np.mean((found - true) ** 2))) for found in (ours, theirs))
        return "RMS errors {:.1e} and {:.1e} {}".format(*rms, unit)

    return words


def scores(side: int) -> np.ndarray:
    """Noise with a blob of 6 deviations for each 100 x 100 pixels."""
    rng = np.random.default_rng(4)
    blobs = np.zeros((side, side), np.float32)
    blobs[tuple(rng.integers(0, side, (2, side * side // 10_000)))] = 1
    blobs = ndimage.gaussian_filter(blobs, 3.0) * np.float32(6 * 2 * np.pi * 9)
    noise = ndimage.gaussian_filter(rng.normal(size=(side, side)).astype(np.float32), 0.7)
    return noise / noise.std() + blobs


def heights(side: int) -> np.ndarray:
    """Patches of three levels, a third of them unmeasured."""
    rng = np.random.default_rng(2)
    patches = ndimage.gaussian_filter(rng.normal(size=(2, side, side)).astype(np.float32), (0, 4, 4))
    z_um = LEVEL_UM * np.digitize(patches[0] / patches[0].std(), (-0.4, 0.4)) + rng.normal(0, 0.1, (side, side))
    z_um[patches[1] > np.quantile(patches[1], 2 / 3)] = np.nan
    return z_um.astype(np.float32)


def shifts() -> np.ndarray:
    return np.random.default_rng(5).uniform(-1, 1, (SEEDS, 2))


def noise_px(seed: int) -> float:
    return float(np.geomspace(0.03, 0.6, SEEDS)[seed])


def few_on_circle(seed: int) -> np.ndarray:
    """As `circle`, with two outliers for each point, as candidates along rays are."""
    return circle(seed, 2 / 3)


def circle(seed: int, outliers: float = 0.1) -> np.ndarray:
    """Points (x, y) on a circle about the origin, some of them at other radii."""
    rng = np.random.default_rng(seed)
    n = round(2 * np.pi * RADIUS_PX)
    angle, radius = rng.uniform(0, 2 * np.pi, n), RADIUS_PX + rng.normal(0, noise_px(seed), n)
    far = rng.random(n) < outliers
    radius[far] = rng.uniform(RADIUS_PX / 2, 1.3 * RADIUS_PX, np.count_nonzero(far))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def line(seed: int) -> np.ndarray:
    """Points (x, y) on a line, a tenth of them up to 20 px off."""
    rng = np.random.default_rng(seed)
    x = np.arange(400.0)
    y = SLOPE * x + rng.normal(0, noise_px(seed), 400)
    far = rng.random(400) < 0.1
    y[far] += rng.uniform(-20, 20, np.count_nonzero(far))
    return np.stack([x, y], axis=1)


if __name__ == "__main__":
    main()
