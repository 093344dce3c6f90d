"""How often U covers the truth: every tool, on errors correlated over several lengths, and on reconstructed stacks.

    python tests/bench/bench_coverage.py [--quick] [--runs N] [--from SEED] [--only TOOL ...] [--correlation PX ...]
    python tests/bench/bench_coverage.py --reconstructed [N] [--rays] [--quick] [--from SEED] [--only TOOL ...]

Each run draws a sample of its own by seed (tilt, sizes, depth or radius) with normal noise of 0.1 um, correlated over
so many pixels: the standard deviation of the Gaussian that white noise is smoothed with is half of it, and a focus
window of 9 px correlates about so far. Scales are exact and nothing lies between frames, so U is what the heights
themselves say. The texture is told its noise.

--reconstructed: the same samples as focus stacks (`tests/truth/smooth_scenes.py`) with an instrument of their own by
seed: NA .14 to .45, steps of .2 to .9 depths of field, texture contrast 4 to 25 %, 6 to 40 ke, frames that jitter or
flicker in a fifth each. N stacks (60) of each sample are reconstructed with the default recipe and measured by the same
tools. The texture is told the noise that repeats would show: the scatter of its errors. --rays: their lens blurs by
rays instead of waves.

The goal: U (k = 2) covers 93 to 97 % of the runs, and in no cell less than 90 %; of reconstructed stacks U is 2 to 4.5
times the error in the median, as it is 3.0 times one that is normal. Seeds below 1000 are
for tuning; --from: the first seed.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from tests.bench.harness import percent, read_options, show, some_of
from tests.support.bumped_surface import bumped
from tests.support.surfaces import PIXEL_UM, calibration, coordinates, noise_of, surface_of
from tests.truth.smooth_scenes import Lens, Optics, drawn_optics, stack_of
from tests.truth.unseen import FIRST_REPORTED_SEED, use_of
from wafer_viewer.measure.texture.areal_texture import texture
from wafer_viewer.measure.tools.angle import face_angle
from wafer_viewer.measure.tools.coplanarity import coplanarity
from wafer_viewer.measure.tools.flatness import flatness
from wafer_viewer.measure.tools.point import distance, point_height
from wafer_viewer.measure.tools.profile import profile
from wafer_viewer.measure.tools.radius import bump_radius
from wafer_viewer.measure.tools.step_height import step_height
from wafer_viewer.measure.tools.step_profile import step_profile
from wafer_viewer.measure.tools.volume import area_volume
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.quantity import Length, Quantity
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.reconstruct.field_pipeline import reconstruct

RUNS, QUICK_RUNS = 200, 5
STACKS, QUICK_STACKS = 60, 3
CORRELATIONS_PX = (0.0, 3.0, 9.0, 16.0, 32.0)
NOISE_UM, WINDOW_PX = 0.1, 9
LEAST_COVERED, COVERED = 0.90, (0.93, 0.97)
SHALLOW_UM = 4.0
"""Height of bumps that are reconstructed: the lens sees their flanks."""
CHANCE = 2.0
"""Deviations of a share of few runs that chance explains."""

Runs = dict[str, tuple[float, float]]
"""Error and expanded uncertainty by quantity."""
Answers = Iterator[tuple[str, float, Length | Quantity]]
"""Name of a quantity, its true value, and what was measured."""


class Instrument(Protocol):
    """What measures a sample."""

    @property
    def seed(self) -> int: ...

    @property
    def rng(self) -> np.random.Generator: ...

    def measured(self, z_um: np.ndarray) -> HeightMap:
        """The surface as it is measured."""
        ...


@dataclass(frozen=True)
class Errors:
    """Errors of heights that a sample gets."""

    seed: int
    correlation_px: float

    def measured(self, z_um: np.ndarray) -> HeightMap:
        """The surface as it is measured."""
        noisy = z_um + noise_of((self.seed, 7), z_um.shape, NOISE_UM, self.correlation_px)
        return surface_of(noisy, calibration=calibration(0.0), recipe=Recipe(window=WINDOW_PX), z_step_um=0.0)

    @property
    def rng(self) -> np.random.Generator:
        """Draws the sample."""
        return np.random.default_rng((self.seed, 8))


@dataclass(frozen=True)
class Reconstructed:
    """A focus stack of a sample, reconstructed with the defaults."""

    seed: int
    lens: Lens = "waves"

    @property
    def optics(self) -> Optics:
        return dataclasses.replace(drawn_optics(np.random.default_rng((self.seed, 9))), lens=self.lens)

    def measured(self, z_um: np.ndarray) -> HeightMap:
        """The surface as it is measured."""
        stack = stack_of(z_um, self.optics, np.random.default_rng((self.seed, 7)), PIXEL_UM)
        found = reconstruct(stack, threads=1)
        at = coordinates(*z_um.shape)
        held = replace(found.provenance, calibration=calibration(0.0))
        return dataclasses.replace(found, provenance=held, x0_um=float(at[0][0]), y0_um=float(at[1][0]))

    @property
    def rng(self) -> np.random.Generator:
        """Draws the sample."""
        return np.random.default_rng((self.seed, 8))


def ground(rng: np.random.Generator, rows: int = 240, cols: int = 320) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places x and y, and the heights of a plane tilted by up to 20 mrad, each [row, col]."""
    x_um, y_um = np.meshgrid(*coordinates(rows, cols))
    tilt_x, tilt_y = rng.uniform(-0.02, 0.02, 2)
    return x_um, y_um, tilt_x * x_um + tilt_y * y_um


def points(errors: Instrument) -> Answers:
    """Heights of two points of a plane, and the distance between them."""
    rng = errors.rng
    x_um, y_um, z_um = ground(rng)
    surface = errors.measured(z_um)
    (i, j), (k, m) = rng.integers(40, 200, (2, 2))
    at = [Region.point(float(x_um[r, c]), float(y_um[r, c])) for r, c in ((i, j), (k, m + 40))]
    first, second = z_um[i, j], z_um[k, m + 40]
    yield "point", first, point_height(surface, at[0]).height
    apart = distance(surface, *at)
    yield "distance along z", second - first, apart.dz
    yield "slope", np.degrees(np.arctan2(second - first, apart.lateral.value_um)), apart.slope


def step(errors: Instrument) -> Answers:
    """Two faces, small or large."""
    rng = errors.rng
    x_um, _, z_um = ground(rng)
    high_um, side_um = rng.uniform(5, 50), rng.uniform(15, 60)
    surface = errors.measured(z_um + np.where(x_um < 0, high_um, 0.0))
    upper, lower = (Region.rectangle(x0, -side_um / 2, x0 + side_um, side_um / 2) for x0 in (-5 - side_um, 5.0))
    yield "step", high_um, step_height(surface, upper, lower).height


def groove(errors: Instrument) -> Answers:
    """A groove, and a step along a line."""
    rng = errors.rng
    x_um, _, z_um = ground(rng)
    deep_um, wide_um = rng.uniform(5, 30), rng.uniform(18, 40)
    surface = errors.measured(z_um - np.where(np.abs(x_um) < wide_um / 2, deep_um, 0.0))
    line = Region.line(-75.0, 3.0, 75.0, 3.0, width_um=rng.uniform(2, 20))
    yield "groove", deep_um, step_profile(surface, line).height


def roof(errors: Instrument) -> Answers:
    """The angle between two faces."""
    rng = errors.rng
    x_um, _, z_um = ground(rng)
    slopes = rng.uniform(-0.3, 0.3, 2)
    tilt = np.gradient(z_um, axis=1)[0, 0] / PIXEL_UM, -np.gradient(z_um, axis=0)[0, 0] / PIXEL_UM
    surface = errors.measured(z_um + np.where(x_um < 0, *(slopes[:, None, None] * x_um)))
    first, second = (Region.rectangle(x0, -40, x0 + 60, 40) for x0 in (-65.0, 5.0))
    normals = [np.array([-tilt[0] - slope, -tilt[1], 1.0]) for slope in slopes]
    cosine = normals[0] @ normals[1] / np.linalg.norm(normals[0]) / np.linalg.norm(normals[1])
    yield "angle", np.degrees(np.arccos(cosine)), face_angle(surface, first, second).angle


def bump(errors: Instrument) -> Answers:
    """A spherical cap: radius, top, and volume."""
    rng = errors.rng
    x_um, y_um = np.meshgrid(*coordinates(240, 320))
    high_um, foot_um = rng.uniform(4, 15), rng.uniform(20, 40)
    radius_um = (foot_um**2 + high_um**2) / (2 * high_um)
    away2 = x_um**2 + y_um**2
    cap = np.sqrt(np.maximum(radius_um**2 - away2, 0.0)) - radius_um + high_um
    surface = errors.measured(np.where(away2 < foot_um**2, np.maximum(cap, 0.0), 0.0))
    found = bump_radius(surface, Region.circle(0.0, 0.0, 1.15 * foot_um))
    yield "radius", radius_um, found.radius
    yield "top", high_um, found.top
    volume_um3 = np.pi * high_um * (3 * foot_um**2 + high_um**2) / 6
    yield "volume", volume_um3, area_volume(surface, Region.circle(0.0, 0.0, 1.3 * foot_um)).volume_above


def bumps(errors: Instrument) -> Answers:
    """Coplanarity, mean and range of heights of 16 bumps, one of them tall; of those that are found."""
    high_um = 15.0 if isinstance(errors, Errors) else SHALLOW_UM
    made = bumped(side=4, seed=errors.seed, noise_um=0.0, high_um=high_um, tall_um=0.2 * high_um)
    surface = errors.measured(made.surface.z_um)
    x0, y0, x1, y1 = surface.bounds_um
    found = coplanarity(surface, Region.rectangle(x0, y0, x1, y1))
    made = made.nearest([(bump.place.x_um, bump.place.y_um) for bump in found.bumps])
    yield "coplanarity", made.range_um, found.coplanarity
    over = made.tops[:, 2] - made.tilt * made.tops[:, 0]
    yield "mean height of bumps", float(over.mean()), found.mean_height
    yield "range of bump heights", float(np.ptp(over)), found.height_range


def bowed(errors: Instrument) -> Answers:
    """Flatness of a face that is bowed, twisted and curved to the third order."""
    rng = errors.rng
    x_um, y_um, z_um = ground(rng)
    across, down, high_um = x_um / 60, y_um / 60, np.exp(rng.uniform(np.log(0.2), np.log(3.0)))
    shapes = across**2, down**2, across * down, across**3, across**2 * down
    z_um = z_um + high_um * sum(share * shape for share, shape in zip(rng.normal(0, 0.5, 5), shapes, strict=True))
    wide_um, tall_um = rng.uniform(50, 130), rng.uniform(50, 100)
    face = Region.rectangle(-wide_um / 2, -tall_um / 2, wide_um / 2, tall_um / 2)
    truth, found = flatness(surface_of(z_um), face), flatness(errors.measured(z_um), face)
    yield "FLTt", truth.flt_t.value_um, found.flt_t
    yield "FLTt, minimum zone", truth.flt_t_minimum_zone.value_um, found.flt_t_minimum_zone
    yield "FLTq", truth.flt_q.value_um, found.flt_q


def section(errors: Instrument) -> Answers:
    """Pt and rise of a profile over a tilted face with a bow, which may be lower than the noise."""
    rng = errors.rng
    x_um, y_um, z_um = ground(rng)
    z_um = z_um + np.exp(rng.uniform(np.log(0.02), np.log(3.0))) * np.cos(x_um / 20 + y_um / 35)
    across, down = rng.uniform(40, 75), rng.uniform(-50, 50)
    line = Region.line(-across, -down, across, down, width_um=float(rng.choice([0.0, 3.0, 12.0])))
    truth, found = profile(surface_of(z_um), line)[0], profile(errors.measured(z_um), line)[0]
    yield "Pt", truth.pt.value_um, found.pt
    yield "rise of a profile", truth.rise.value_um, found.rise


def waves(errors: Instrument) -> Answers:
    """Texture of random waves, with and without an S-filter."""
    rng = errors.rng
    x_um, _, z_um = ground(rng)
    rough_um, length_px = np.exp(rng.uniform(np.log(0.2), np.log(2.0))), rng.uniform(6, 16)
    z_um = z_um + noise_of((errors.seed, 6), x_um.shape, rough_um, 2 * length_px)
    face = Region.rectangle(-60, -50, 60, 50)
    surface = errors.measured(z_um)
    noise_um = NOISE_UM if isinstance(errors, Errors) else float(np.nanstd(surface.to_measure() - z_um))
    for name, options in {"": {}, ", S-filter": {"s_filter_um": 10.0}}.items():
        truth = texture(surface_of(z_um), face, **options)
        found = texture(surface, face, noise_um=noise_um, **options)
        for field in ("sa", "sq", "sz"):
            yield field.capitalize() + name, getattr(truth, field).value_um, getattr(found, field)


SAMPLES: dict[str, Callable[[Instrument], Answers]] = {
    "points": points, "step": step, "groove": groove, "angle": roof, "bump": bump, "bumps": bumps,
    "flatness": bowed, "section": section, "texture": waves,
}  # fmt: skip


@dataclass(frozen=True)
class Cell:
    """What came of many runs: errors and expanded uncertainties, float64 [n]; NaN where none was evaluated."""

    error: np.ndarray
    expanded: np.ndarray

    @property
    def known(self) -> np.ndarray:
        """Whether the uncertainty of a run was evaluated, bool [n]."""
        return np.isfinite(self.expanded)

    @property
    def covered(self) -> float:
        """Share of the runs with an uncertainty that covers the truth."""
        known = self.known
        return float(np.mean(np.abs(self.error[known]) <= self.expanded[known])) if known.any() else float("nan")

    @property
    def counted(self) -> str:
        """The share with the number of runs, and `LOW` where it is below the least by more than chance."""
        low = self.covered < LEAST_COVERED - self._by_chance(LEAST_COVERED)
        return f"{percent(self.covered, 0)} of {self.known.sum()}{' LOW' if low else ''}"

    def _by_chance(self, share: float) -> float:
        """How far chance moves a share of these runs."""
        return CHANCE * float(np.sqrt(share * (1 - share) / max(self.known.sum(), 1)))

    @property
    def verdict(self) -> str:
        """`met`, `LOW` or `wide` against the goal, as far as chance lets tell."""
        share, by_chance, (low, high) = self.covered, self._by_chance(0.95), COVERED
        return "LOW" if share < low - by_chance else "wide" if share > high + by_chance else "met"


def cells(sample: Callable[[Instrument], Answers], seeds: range, correlation_px: float) -> dict[str, Cell]:
    """The runs of a sample, by quantity."""
    found = (answers(sample, Errors(seed, correlation_px)) for seed in seeds)
    return gathered(one for one in found if one is not None)


def answers(sample: Callable[[Instrument], Answers], instrument: Instrument) -> Runs | None:
    """Error and expanded uncertainty of each quantity of a sample; None where a tool refuses it."""
    found: Runs = {}
    try:
        for name, truth, measured in sample(instrument):
            value, expanded = numbers_of(measured)
            found[name] = value - truth, expanded
    except MeasureError:
        return None
    return found


def gathered(each: Iterable[Runs]) -> dict[str, Cell]:
    """The runs of many samples, by quantity."""
    found: dict[str, list[tuple[float, float]]] = {}
    for one in each:
        for name, run in one.items():
            found.setdefault(name, []).append(run)
    return {name: Cell(*np.array(runs).T) for name, runs in found.items()}


def numbers_of(measured: Length | Quantity) -> tuple[float, float]:
    """Value and expanded uncertainty, NaN where it was not evaluated."""
    quantity = measured.quantity if isinstance(measured, Length) else measured
    return quantity.value, float("nan") if quantity.expanded is None else quantity.expanded


CELLS: dict[str, Callable[[Optics], bool]] = {
    "all": lambda of: True,
    "frames jitter": lambda of: of.jitter_dof > 0,
    "others": lambda of: not of.jitter_dof,
    "NA < .22": lambda of: not of.jitter_dof and of.na < 0.22,
    "NA > .31": lambda of: not of.jitter_dof and of.na > 0.31,
    "step < .45": lambda of: not of.jitter_dof and of.step_dof < 0.45,
    "step > .7": lambda of: not of.jitter_dof and of.step_dof > 0.7,
    "contrast < 8 %": lambda of: not of.jitter_dof and of.contrast < 0.08,
    "> 14 %": lambda of: not of.jitter_dof and of.contrast > 0.14,
    "flicker": lambda of: not of.jitter_dof and of.flicker > 0,
}
"""Parts of the instruments; steps in depths of field; frames that jitter are apart."""


def show_reconstructed(names: Sequence[str], seeds: range, lens: Lens) -> None:
    """Coverage on reconstructed stacks, by quantity and by what they were taken with."""
    rows = []
    for name in names:
        began = time.perf_counter()
        instruments = [Reconstructed(seed, lens) for seed in seeds]
        every = [(one.optics, answers(SAMPLES[name], one)) for one in instruments]
        found = [(optics, one) for optics, one in every if one is not None]
        refused = len(every) - len(found)
        print(f"({name}: {refused} of {len(seeds)} refused, {time.perf_counter() - began:.0f} s)", flush=True)
        parts = {cell: gathered(one for optics, one in found if fits(optics)) for cell, fits in CELLS.items()}
        for quantity, whole in parts["all"].items():
            of_u = np.abs(2 * whole.error / whole.expanded)
            off = f"{np.sqrt(np.nanmean(of_u**2)):.2f}", f"{2 / np.nanmedian(of_u):.1f}"
            shares = [part[quantity].counted if quantity in part else "" for part in parts.values()]
            rows.append((quantity, whole.verdict, *off, *shares))
    header = ("U covers, % of the stacks", "goal", "rms of error / u", "median of U / error", *CELLS)
    drawn = f"seeds from {seeds.start} ({use_of(seeds.start)}), a lens of {lens}"
    show(f"SIMULATED stacks, {len(seeds)} of each sample, {drawn}", header, rows)


def main() -> None:
    asked = read_options(
        __doc__,
        runs=RUNS,
        first_seed=FIRST_REPORTED_SEED,
        only=some_of(SAMPLES),
        correlation=CORRELATIONS_PX,
        reconstructed={"type": int, "nargs": "?", "const": STACKS, "metavar": "N", "help": "stacks of each sample"},
        rays={"action": "store_true", "help": "the lens of the stacks blurs by rays, not by waves"},
    )
    if asked.reconstructed:
        stacks = QUICK_STACKS if asked.quick else asked.reconstructed
        show_reconstructed(
            asked.only, range(asked.first_seed, asked.first_seed + stacks), "rays" if asked.rays else "waves"
        )
        return
    seeds = range(asked.first_seed, asked.first_seed + (QUICK_RUNS if asked.quick else asked.runs))
    rows: dict[str, list[str]] = {}
    for name in asked.only:
        began = time.perf_counter()
        for correlation_px in asked.correlation:
            for quantity, cell in cells(SAMPLES[name], seeds, correlation_px).items():
                off = float(np.sqrt(np.nanmean((2 * cell.error / cell.expanded) ** 2)))
                told = f"{percent(cell.covered)} {'' if asked.quick else cell.verdict} ({off:.2f})"
                rows.setdefault(quantity, []).append(told)
        print(f"({name}: {time.perf_counter() - began:.0f} s)", flush=True)
    header = ("U covers, % of the runs (rms of error / u)", *(f"over {px:g} px" for px in asked.correlation))
    runs = f"{len(seeds)} runs each, seeds from {asked.first_seed} ({use_of(asked.first_seed)})"
    show(f"SIMULATED noise of {NOISE_UM} um, {runs}", header, [(quantity, *told) for quantity, told in rows.items()])


if __name__ == "__main__":
    main()
