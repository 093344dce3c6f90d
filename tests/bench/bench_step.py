"""A step of 399.88 um between two simulated faces, many times over: is its height right, and does U cover the truth?

    python tests/bench/bench_step.py [--quick] [--runs N] [--correlation 2 8 20]

Two regions of 800 x 800 pixels, noise of 1 um correlated over 2, 8 and 20 px (standard deviation of the Gaussian that
white noise is smoothed with), 0.1 % of the points 50 um off, the sample tilted by 0.5 mrad; 1000 runs each, --quick:
5. Everything is simulated: the z scale is exact, there is no certificate's term and nothing between frames, so U is
what the scatter of the heights themselves says.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from tests.bench.harness import read_options, show, took
from tests.support.surfaces import height_map
from wafer_viewer.measure.tools.step_height import step_height
from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import HeightMap

STEP_UM, NOISE_UM, TILT = 399.88, 1.0, 0.5e-3
SIDE_PX, GAP_PX, PIXEL_UM = 800, 50, 0.46729
DOMAIN_PX = 972
"""Noise repeats over so many pixels: more than a face and what is correlated with it."""
OUTLIERS, OUTLIER_UM = 1e-3, 50.0
CORRELATIONS_PX = (2, 8, 20)
BIAS_UM, COVERED = 0.005, (0.93, 0.97)
EXACT = Calibration(pixel_um=PIXEL_UM, u_pixel_um=0.0, u_z_scale=0.0, made="2026-01-01", due="2099-01-01", against="")
Floats = NDArray[np.float32]


@dataclass(frozen=True)
class Runs:
    """What came of many runs at one correlation length: errors and expanded uncertainties, float64 [n]."""

    correlation_px: float
    errors_um: NDArray[np.float64]
    expanded_um: NDArray[np.float64]

    @property
    def bias_um(self) -> float:
        return float(self.errors_um.mean())

    @property
    def allowed_um(self) -> float:
        """5 nm, or what chance makes of so many runs."""
        return max(BIAS_UM, 3 * float(self.errors_um.std(ddof=1)) / len(self.errors_um) ** 0.5)

    @property
    def covered(self) -> float:
        return float(np.mean(np.abs(self.errors_um) <= self.expanded_um))


def runs(correlation_px: float, seeds: range, side_px: int = SIDE_PX) -> Runs:
    """The step of every seed."""
    found = np.array(list(_steps(correlation_px, seeds, side_px)))
    return Runs(correlation_px, found[:, 0] - STEP_UM, found[:, 1])


def _steps(correlation_px: float, seeds: range, side_px: int) -> Iterator[tuple[float, float]]:
    for seed in seeds:
        surface = two_faces(seed, correlation_px, side_px)
        x0, y0, x1, y1 = surface.bounds_um
        width_um = (side_px - 1) * PIXEL_UM
        upper, lower = Region.rectangle(x0, y0, x0 + width_um, y1), Region.rectangle(x1 - width_um, y0, x1, y1)
        height = step_height(surface, upper, lower).height
        yield height.value_um, height.expanded_um or 0.0


def two_faces(seed: int, correlation_px: float, side_px: int = SIDE_PX) -> HeightMap:
    """The upper face on the left, the lower on the right, nothing measured between them."""
    rng = np.random.default_rng((seed, round(correlation_px * 1000)))
    z_um = np.full((side_px, 2 * side_px + GAP_PX), np.nan, np.float32)
    noise = _noise(rng, correlation_px, side_px)
    z_um[:, :side_px], z_um[:, -side_px:] = noise[0] + np.float32(STEP_UM), noise[1]
    away = rng.integers(z_um.size, size=round(OUTLIERS * z_um.size))
    z_um.flat[away] += rng.choice(np.array([-OUTLIER_UM, OUTLIER_UM], np.float32), len(away))
    cols, rows = np.arange(z_um.shape[1], dtype=np.float32), np.arange(side_px, dtype=np.float32)
    z_um += np.float32(TILT * PIXEL_UM) * (np.float32(0.8) * cols + np.float32(0.6) * rows[:, None])
    code = np.where(np.isfinite(z_um), np.uint8(0), np.uint8(10))
    return height_map(z_um, PIXEL_UM, grey=code, confidence=z_um, origin=code, calibration=EXACT, simulated=True)


def _noise(rng: np.random.Generator, correlation_px: float, side_px: int) -> tuple[Floats, Floats]:
    """Two independent faces of noise: the real and the imaginary part of one transform."""
    domain = fft.next_fast_len(round(side_px + DOMAIN_PX - SIDE_PX))
    white = rng.standard_normal((domain, 2 * domain), np.float32).view(np.complex64)
    both = fft.fft2(white * _spectrum(domain, correlation_px), overwrite_x=True)
    return both.real[:side_px, :side_px], both.imag[:side_px, :side_px]


@cache
def _spectrum(domain: int, correlation_px: float) -> Floats:
    """Of white noise smoothed by a Gaussian, so that the noise has its standard deviation."""
    f = fft.fftfreq(domain) * 2 * np.pi * correlation_px
    gain = np.exp(-(f[:, None] ** 2 + f**2) / 2)
    return (NOISE_UM * gain / np.sqrt(np.sum(gain**2))).astype(np.float32)


def main() -> None:
    asked = read_options(__doc__, runs=1000, correlation=[float(px) for px in CORRELATIONS_PX])
    n = 5 if asked.quick else asked.runs
    rows: list[tuple[str, ...]] = []
    for correlation_px in asked.correlation:
        done = took(lambda px=correlation_px: runs(px, range(n)))
        rows.append((*_row(done.result, judged=not asked.quick), f"{done.clock_s / n:.2f}"))
        print("  ".join(rows[-1]), flush=True)
    header = "correlation, px | bias, um | allowed | spread, um | mean U, um | U covers |  | s a run"
    show(f"SIMULATED step of {STEP_UM} um, {n} runs each; U without a certificate's term", header, rows)


def _row(of: Runs, judged: bool) -> tuple[str, ...]:
    low, high = COVERED
    met = abs(of.bias_um) <= of.allowed_um and low <= of.covered <= high
    return (
        f"{of.correlation_px:g}",
        f"{of.bias_um:+.4f}",
        f"{of.allowed_um:.4f}",
        f"{of.errors_um.std(ddof=1):.4f}",
        f"{of.expanded_um.mean():.4f}",
        f"{of.covered:.1%}",
        "" if not judged else "met" if met else "MISSED",
    )


if __name__ == "__main__":
    main()
