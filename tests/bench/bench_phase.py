"""How far peaks between frames follow the place of the frames: phase error and noise of every peak, and its cost.

    python tests/bench/bench_phase.py [--quick] [--seed N]

A plane in small stairs, blurred by the transfer of waves, in one case by that of rays (`tests/truth/phase.py`), 8 bits
of 15 000 electrons. The phase
error is the rms of the first three sine harmonics of the error over a step, without sampling noise; what it reads at a
contrast of 5 % is mostly what is left of that noise. Beside the errors stands the standard uncertainty that heights
carry for it. --quick: one aperture, one contrast and three steps.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from tests.bench.harness import read_options, show, took
from tests.truth.phase import PhaseError, Stairs, Tilted, errors_of, phase_error, pooled, stairs
from wafer_viewer.model.spec import replace as changed
from wafer_viewer.model.surface.focus_measures import focus_measures
from wafer_viewer.model.surface.frame_health import interpolation_u_um
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.reconstruct.auto_tuning import focus_width, search_of
from wafer_viewer.reconstruct.focus.focus_volume import Volume
from wafer_viewer.reconstruct.focus.peak import Peaks
from wafer_viewer.reconstruct.focus.peak_interpolation import PEAKS
from wafer_viewer.reconstruct.focus.peak_search import Search, ThreadScratch, fill_volume, find_peaks
from wafer_viewer.reconstruct.frame_blocks import Frames, StackSource, developed, stripes
from wafer_viewer.reconstruct.preprocess.camera_noise import settled_noise
from wafer_viewer.reconstruct.preprocess.frames import prepare

STEPS_DOF, QUICK_STEPS_DOF = (0.2, 0.3, 0.45, 0.6, 0.75, 0.9), (0.3, 0.45, 0.75)
APERTURES, CONTRASTS, SEEDS = (0.20, 0.28, 0.38, 0.45), (0.25, 0.12, 0.05), 2
CASES = {
    "no noise": {"full_well_e": None},
    "frames up to 0.1 step off": {"jitter": 0.1},
    "frames up to 0.3 step off": {"jitter": 0.3},
    "16 bits": {"bits": 16},
    "mirror grains": {"grains": 0.005},
    "lens of rays": {"lens": "rays"},
}
CARRIED = "u carried by centred"
"""Row of the standard uncertainty that a height carries."""
FORMER = "blur_law"
"""The peak that costs are compared with."""


@dataclass(frozen=True, eq=False)
class Measured:
    """A stack whose focus is measured: its peaks cost no more than their search."""

    frames: Frames
    recipe: Recipe
    peak_width_um: float
    source: StackSource
    bench: ThreadScratch
    peaks: Peaks

    @classmethod
    def of(cls, seen: Stairs, measure: str) -> Measured:
        frames = prepare(seen.stack)
        recipe = Recipe(focus_measure=measure, window=9)
        recipe = changed(recipe, noise=settled_noise(frames, recipe.noise))
        width = focus_width(frames, recipe)
        recipe = changed(recipe, focus_width_um=width.um)
        search = search_of(recipe, frames.n_frames, frames.step_um)
        bench = ThreadScratch.make(frames.n_frames, frames.shape, search, frames.dtype)
        peaks = Peaks.empty(frames.shape, frames.dtype, frames.n_frames)
        ((_, source),) = developed(frames, stripes(frames.shape, frames.shape[0]), search.margin_px)
        fill_volume(source, search, bench.rows, Volume(*bench.curves, peaks.clipped, peaks.coarse))
        return cls(frames, recipe, width.peak_um, source, bench, peaks)

    @property
    def carried(self) -> float:
        """The standard uncertainty of heights of centred peaks for the place of the frames, in steps."""
        step_um = self.frames.step_um
        return interpolation_u_um("centred", step_um, self.peak_width_um) / step_um

    def search(self, peak: str) -> Search:
        return search_of(changed(self.recipe, peak=peak), self.frames.n_frames, self.frames.step_um)

    def find(self, peak: str) -> None:
        """Place the peaks."""
        find_peaks(self.source, self.frames.z_um, self.search(peak), self.bench.curves, self.bench.spots, self.peaks)

    def ns_per_pixel(self, peak: str, runs: int = 15) -> float:
        """The least processor time of several runs."""
        return 1e9 * took(lambda: self.find(peak), runs).processor_s / self.peaks.z_um.size


def main() -> None:
    wanted = read_options(__doc__, seed=1000)
    steps = QUICK_STEPS_DOF if wanted.quick else STEPS_DOF
    for contrast in CONTRASTS[1:2] if wanted.quick else CONTRASTS:
        found = {step: {} for step in steps}
        for step in steps:
            scenes = scenes_of(Tilted(step_dof=step, contrast=contrast), wanted.quick, wanted.seed)
            found[step] = errors(scenes, tuple(focus_measures()))
        show_errors(f"contrast {100 * contrast:g} %", found)
    for name, change in CASES.items():
        found = {}
        for step in steps:
            scenes = scenes_of(replace(Tilted(step_dof=step), **change), wanted.quick, wanted.seed)
            found[step] = errors(scenes, ("log_laplacian",))
        show_errors(f"contrast 25 %, {name}", found)
    show_costs(steps, wanted.seed)


def scenes_of(scene: Tilted, quick: bool, seed: int) -> Iterator[Stairs]:
    """A scene with every aperture and several textures."""
    for na in APERTURES[1:2] if quick else APERTURES:
        for n in range(1 if quick else SEEDS):
            yield stairs(replace(scene, na=na, seed=seed + n))


def errors(scenes: Iterator[Stairs], measures: tuple[str, ...]) -> dict[tuple[str, str], PhaseError]:
    """Errors by measure and peak."""
    found: dict[tuple[str, str], list[PhaseError]] = {}
    for seen in scenes:
        for measure in measures:
            measured = Measured.of(seen, measure)
            for peak in PEAKS:
                measured.find(peak)
                one = phase_error(*errors_of(seen, measured.peaks.z_um.astype(np.float64)))
                found.setdefault((measure, peak), []).append(one)
            found.setdefault((measure, CARRIED), []).append(PhaseError(measured.carried**2, np.nan, 0.0))
    return {name: pooled(each) for name, each in found.items()}


def show_errors(title: str, found: dict[float, dict[tuple[str, str], PhaseError]]) -> None:
    rows = [
        (
            f"{measure}, {peak}",
            *(_in_words(one) for one in (f[measure, peak] for f in found.values())),
        )
        for measure, peak in next(iter(found.values()))
    ]
    header = ("measure, peak", *(f"{step:g}" for step in found))
    show(f"Phase error rms / noise of a pixel, in steps, {title}, at a step in depths of field of", header, rows)


def _in_words(one: PhaseError) -> str:
    return f"{one.rms:.3f}" if np.isnan(one.noise) else f"{one.rms:.3f} / {one.noise:.3f}"


def show_costs(steps: tuple[float, ...], seed: int) -> None:
    rows = []
    for step in steps:
        measured = Measured.of(
            stairs(Tilted(step_dof=step, contrast=0.12, shape=(32, 1024), seed=seed)), "log_laplacian"
        )
        ns = {peak: measured.ns_per_pixel(peak) for peak in PEAKS}
        rows.append((f"{step:g}", *(f"{value:.0f} ({value / ns[FORMER]:.2f})" for value in ns.values())))
    show(f"Search of the peak with its scores, ns a pixel (over {FORMER})", ("step in depths of field", *PEAKS), rows)


if __name__ == "__main__":
    main()
