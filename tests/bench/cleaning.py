"""What cleaning a height map does to its errors, and what it costs: smoothing, outliers, fill.

    python tests/bench/cleaning.py [--quick]

Maps with errors put in by hand show each mode by itself; scenes made by rays show the smoothing and what each rule for
outliers earns on real errors (a height more than 4 um off is false). Times are the least processor time of several
runs on one thread. Light once traced is kept in the folder of temporary files. --quick: under a minute.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from tests.bench.harness import read_options, took
from tests.support.noisy_maps import noisy_step, rmse
from tests.support.paths import ROOT
from tests.truth.layouts import PILLBOX, TUNING, Layout, take
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.recipe import Fill, Levy, Outliers, Recipe
from wafer_viewer.reconstruct.cleaning import clean as rules
from wafer_viewer.reconstruct.cleaning.clean import (
    clean,
    far_in_cloud,
    far_on_lattice,
    fill,
    find_outliers,
    settle_cleaning,
    settle_levy,
)
from wafer_viewer.reconstruct.cleaning.levy_flight import SMOOTHERS, height_noise_um, smooth
from wafer_viewer.reconstruct.field_pipeline import (
    correct_edges,
    gate_peaks,
    prepare_field,
    search_peaks,
)

KEPT_LIGHT = Path(tempfile.gettempdir()) / "wafer-viewer-truth"
FALSE_UM, PIXEL_UM, STEP_UM = 4.0, 0.46729, 4.0
SCENES = tuple(Layout(name, PILLBOX, 21 + n, scene=name) for n, name in enumerate(("stair", "plane", "cone", "step")))

Map = NDArray[np.float32]


@dataclass(frozen=True)
class Seen:
    """A gated map of a scene, its truth, the settled recipe and what the optics resolve along z."""

    name: str
    z_um: Map
    truth_um: NDArray[np.floating]
    recipe: Recipe
    resolution_um: float


def main() -> None:
    quick = read_options(__doc__).quick
    show_modes()
    show_sor(200 if quick else 500)
    show_fill()
    show_speed()
    show_compile_times()
    for seen in scenes(quick):
        show_smoothing(seen)
        show_rules(seen)


def show_modes() -> None:
    """The experiment behind the choice of mode: a step of 40 um with noise, salt and blobs."""
    truth, z = noisy_step()
    print(f"\n512 x 512, step 40 um, noise 1.5 um, 3 % salt, 60 blobs of 5 x 5: RMSE {rmse(z, truth):.2f} um")
    for mode in SMOOTHERS:
        levy = settle_levy([z], Levy(mode=mode), STEP_UM)
        fixed = replace(levy, alpha=0.5, n_sigma=3.0, iterations=30 if mode in ("literal", "guided") else 6)
        after = [rmse(smooth(z, how, 10.0), truth) for how in (fixed, levy)]
        print(
            f"  {mode:17s} alpha .5, 3 sigma, {fixed.iterations:2d} rounds {after[0]:6.2f} um; "
            f"auto (alpha {levy.alpha:.2f}, {levy.n_sigma:g} sigma, {levy.iterations:2d} rounds) {after[1]:6.2f} um, "
            f"{least_ms(lambda how=levy: smooth(z, how, 10.0)):.0f} ms"
        )
    literal = [
        rmse(smooth(z, Levy(mode="literal", n_sigma=3.0, alpha=0.5, iterations=30, seed=s), 10.0), truth)
        for s in range(8)
    ]
    print(f"  literal, 8 seeds: {min(literal):.2f} to {max(literal):.2f} um")


def show_sor(side: int) -> None:
    print("\nstatistical outlier removal, 1 % of errors of 8 to 60 um on a slope with a step of 40 um")
    rng = np.random.default_rng(0)
    z = 0.05 * np.indices((side, side))[1] + rng.normal(0, 0.3, (side, side))
    z[side // 3 : 2 * side // 3, side // 3 :] += 40
    wrong = rng.random(z.shape) < 0.01
    z[wrong] += rng.uniform(8, 60, np.count_nonzero(wrong)) * rng.choice([-1, 1], np.count_nonzero(wrong))
    z = z.astype(np.float32)
    for n_sigma, floor_um in ((1.0, 0.001), (3.0, 6.0)):
        how = Outliers(n_sigma=n_sigma, floor_um=floor_um)
        forms = {"lattice": lambda h=how: far_on_lattice(z, h), "open3d": lambda h=how: far_in_cloud(z, PIXEL_UM, h)}
        found = {name: form() for name, form in forms.items()}
        words = ", ".join(
            f"{name} {np.mean(found[name][wrong]):.1%} of the errors, {np.mean(found[name][~wrong]):.3%} of the rest, "
            f"{least_ms(forms[name], 2) / z.size * 1e6:.0f} ms a Mpx"
            for name in forms
        )
        apart = np.mean(found["lattice"] != found["open3d"])
        print(f"  {n_sigma:g} sigma, floor {floor_um:g} um: judged differently {apart:.3%}; {words}")


def show_fill() -> None:
    """Measured pixels held out: rectangles of 2 to 9 pixels of a wavy surface with noise as wide as a focus window."""
    rng = np.random.default_rng(1)
    rows, cols = np.indices((540, 720))
    truth = 8 * np.sin(cols / 23) + 5 * np.cos(rows / 17)
    z = (truth + gaussian_filter(rng.normal(0, 1, truth.shape), 2) * 2).astype(np.float32)
    held = np.zeros(z.shape, bool)
    for r, c in zip(rng.integers(9, 520, 2000), rng.integers(9, 700, 2000), strict=True):
        high, wide = rng.integers(2, 10, 2)
        held[r : r + high, c : c + wide] = True
    holed = np.where(held, np.float32(np.nan), z)
    print(f"\nfill of held-out pixels, error of the measured ones {rmse(z, truth):.3f} um")
    filled = {
        "rows, then columns": fill(holed, Fill(mode="all"), STEP_UM),
        "by both alike": fill(holed, Fill(), STEP_UM),
    }
    both = held & np.isfinite(sum(filled.values()))
    for name, z_um in filled.items():
        share, off = np.isfinite(z_um[held]).mean(), rmse(z_um[both], truth[both])
        print(f"  {name:18s} {share:.1%} filled, RMSE of what both fill {off:.3f} um")


def show_speed() -> None:
    print("\ncleaning of a field of 1080 x 1440, ms of one thread: smooth, outliers, fill, all")
    for salt, holes in ((0.0, 0.0), (0.03, 0.0), (0.03, 0.3), (0.2, 0.4), (1.0, 0.0)):
        z = a_field(salt, holes)
        recipe = settle_cleaning([z[500:532, 400:528]], Recipe(window=9), STEP_UM)
        smoothed = smooth(z, recipe.levy, STEP_UM)
        rest = np.where(find_outliers(z, smoothed, PIXEL_UM, recipe), np.float32(np.nan), smoothed)
        steps = (
            lambda z=z, r=recipe: smooth(z, r.levy, STEP_UM),
            lambda z=z, s=smoothed, r=recipe: find_outliers(z, s, PIXEL_UM, r),
            lambda z=rest, r=recipe: fill(z, r.fill, STEP_UM),
            lambda z=z, r=recipe: clean(z, PIXEL_UM, r, STEP_UM),
        )
        times = "  ".join(f"{least_ms(step):4.0f}" for step in steps)
        print(f"  {salt:.0%} spikes, {holes:.0%} unmeasured: {times}")


def show_compile_times() -> None:
    """In a process of its own with an empty cache, kernel by kernel."""
    with tempfile.TemporaryDirectory() as empty:
        code = "from tests.bench.cleaning import compile_all; compile_all()"
        settings = {**os.environ, "WAFER_VIEWER_CACHE": empty, "PYTHONPATH": str(ROOT)}
        subprocess.run([sys.executable, "-c", code], check=True, env=settings)


def compile_all() -> None:
    from wafer_viewer.numerics.filters import denoising, interpolation

    z = np.random.default_rng(0).normal(0, 1, (60, 70)).astype(np.float32)
    z[20:24, 20:24] = np.nan
    at = np.nonzero(np.isfinite(z))
    padded = {n: np.pad(z, n, constant_values=np.nan) for n in (2, 3, 5)}
    kernels: dict[str, Callable[[], object]] = {
        "lines": lambda: denoising.line_outliers(padded[5], 0.5),
        "medians of lines": lambda: denoising.line_medians_at(padded[5], *at),
        "pairs": lambda: denoising.pair_mean(z, 1.0),
        "neighbours near": lambda: denoising.few_near(padded[3], 1.0, 15),
        "distances": lambda: denoising.mean_distances(padded[3], *at, 15),
        "splines": lambda: interpolation.fill_gaps(z, 9, 1.0),
        "(guided, switching: far)": lambda: denoising.median_outliers(padded[2], np.float32(1)),
        "(guided, switching: medians)": lambda: denoising.medians_at(padded[2], *at),
    }
    np.median(z)
    spent = {name: took(kernel).processor_s for name, kernel in kernels.items()}
    default = sum(s for name, s in spent.items() if not name.startswith("("))
    print("\ncompiling, s: " + ", ".join(f"{name} {s:.2f}" for name, s in spent.items()))
    print(f"  the default recipe's together {default:.2f} s (the first one pays for numba's start)")


def scenes(quick: bool) -> Iterator[Seen]:
    """Gated, uncleaned maps of scenes made by rays."""
    for layout in SCENES[:1] if quick else (*SCENES, *TUNING.values()):
        taken = take(layout, (128, 128) if quick else (320, 320), keep_in=KEPT_LIGHT)
        field = prepare_field(taken.stack)
        z = correct_edges(field, gate_peaks(field, search_peaks(field))).measured_um
        tuned = field.tuned
        recipe = settle_cleaning([z], replace(tuned.recipe, levy=Levy()), tuned.resolution_um)
        yield Seen(layout.name, z, taken.scene.truth_um, recipe, tuned.resolution_um)


def show_smoothing(seen: Seen) -> None:
    """RMSE of heights that are not false; what smoothing leaves of false ones is the outliers' task."""
    near = np.abs(seen.z_um - seen.truth_um) <= FALSE_UM
    errors = [f"unsmoothed {rmse(seen.z_um[near], seen.truth_um[near]):.3f}"]
    for mode in list(SMOOTHERS)[1:]:
        levy = settle_levy([seen.z_um], Levy(mode=mode), seen.resolution_um)
        off = np.clip((smooth(seen.z_um, levy, seen.resolution_um) - seen.truth_um)[near], -FALSE_UM, FALSE_UM)
        errors.append(f"{mode} {np.sqrt(np.mean(off**2)):.3f}")
    noise_um = height_noise_um(seen.z_um)
    print(f"\n{seen.name}: window {seen.recipe.window}, noise by the map itself {noise_um:.3f} um")
    print("  RMSE, um: " + ", ".join(errors))


def show_rules(seen: Seen) -> None:
    """What all rules for outliers drop, and what would be dropped without each."""
    smoothed = smooth(seen.z_um, seen.recipe.levy, seen.resolution_um)
    known = np.isfinite(seen.z_um)
    false = known & (np.abs(seen.z_um - seen.truth_um) > FALSE_UM)
    print(f"  gated: {known.mean():.1%} kept, {false.sum() / known.sum():.2%} of it false")
    for name in ("", "far_on_lattice", "_moved"):
        with without(name):
            dropped = find_outliers(seen.z_um, smoothed, PIXEL_UM, seen.recipe)
        kept = known & ~dropped
        false_kept, good_dropped = (kept & false).sum() / max(1, kept.sum()), (dropped & ~false).sum() / known.sum()
        words = f"without {name.strip('_')}" if name else "dropped"
        print(f"  outliers {words:23s}: {kept.mean():.1%} kept, {false_kept:.2%} false, {good_dropped:.2%} good lost")


class without:  # noqa: N801 - reads as a word
    """A rule for outliers finds nothing."""

    def __init__(self, name: str) -> None:
        self._name, self._kept = name, getattr(rules, name, None)

    def __enter__(self) -> None:
        if self._name:
            setattr(rules, self._name, lambda z, *rest: np.zeros(z.shape, bool))

    def __exit__(self, *fault: object) -> None:
        if self._name:
            setattr(rules, self._name, self._kept)


def a_field(salt: float, holes: float) -> Map:
    """Squares 40 um high on a slope, noise, spikes, and holes as wide as a focus window."""
    rng = np.random.default_rng(0)
    rows, cols = np.indices((1080, 1440))
    z = 40.0 * ((cols // 180 + rows // 180) % 2) + 0.01 * cols + rng.normal(0, 0.3, rows.shape)
    spikes = rng.random(z.shape) < salt
    z[spikes] = rng.uniform(-40, 120, np.count_nonzero(spikes))
    if holes:
        blobs = gaussian_filter(rng.normal(0, 1, z.shape), 6)
        z[blobs < np.quantile(blobs, holes)] = np.nan
    return z.astype(np.float32)


def least_ms(work: Callable[[], object], runs: int = 3) -> float:
    return 1e3 * took(work, runs).processor_s


if __name__ == "__main__":
    main()
