"""Faults of single frames: which are found, and what they do to the height of a step and to its U.

    python tests/bench/bench_health.py [--quick] [--scenes N] [--from SEED]

Two level faces 15 to 40 um apart, blurred by FFT (`tests/truth/bleeding.py`), drawn by seed. Into one stack of each
scene go a flash, a black frame, a frame that shows nothing, one with a band of rows of another frame, and one with a
band that has slipped sideways; others flicker by up to 10 %, or lie up to 0.3 um off along z (standard deviations).
Torn bands are told apart by their change of grey against the noise of the camera. U (k = 2) is that of `step_height`,
with exact scales. Tuning sees seeds below 1000. --quick: six scenes, at most a minute.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from unittest import mock

import numpy as np
from numpy.typing import NDArray

from tests.bench.harness import percent, read_options, show
from tests.support.surfaces import calibration
from tests.truth.bleeding import PIXEL_UM, WAVELENGTH_UM, Bleeding, BlurredLayers
from tests.truth.unseen import FIRST_REPORTED_SEED
from tests.truth.views import Camera
from wafer_viewer.measure.tools.step_height import step_height
from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.acquisition.plan import Field
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace as changed
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.reconstruct.field_pipeline import reconstruct
from wafer_viewer.reconstruct.preprocess import frames as frames_module

SCENES, QUICK_SCENES = 40, 6
SHAPE, TRENCH_PX, PITCH_PX = (96, 240), 110.0, 240.0
LEAST_FRAMES = 25
WALL_PX = 25
"""Distance of the faces from the walls and from the border."""
MOST_FLICKER, MOST_JITTER_UM = 0.10, 0.3
TEARS = ("stale band", "slipped band")
KINDS = ("flash", "black", "blank", *TEARS)
CHANGES = ((0.0, 5.0), (5.0, 20.0), (20.0, np.inf))
"""Bounds of the change of grey by a tear, root mean square in noise."""

Light = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Sample:
    """A scene: light [k, row, col] as a share of white, and the same with every frame a little off along z."""

    scene: Bleeding
    z_um: NDArray[np.float64]
    light: Light
    jittered: Light
    jitter_um: float
    flicker: float
    truth_um: NDArray[np.float32]

    @property
    def about(self) -> str:
        return f"{self.scene.seed}, NA {self.scene.na:.2f}, {len(self.z_um)} frames"

    def stack(self, light: Light) -> FieldStack:
        """What the camera makes of light."""
        images = Camera(self.scene.full_well_e, 0.4).shoot(light, 1.0, self.scene.seed)
        field = Field(number=1, row=0, col=0, x_um=0.0, y_um=0.0, z_start_um=0.0)
        return FieldStack(
            field, images, self.z_um, np.ones(len(images), bool), PIXEL_UM, calibration=calibration(0.0),
            simulated=True, depth_of_field_um=self.scene.depth_of_field_um,
        )  # fmt: skip


@dataclass(frozen=True)
class Planted:
    """A fault of a frame: its kind, its frame from 1, its change of grey in noise, and whether it was named."""

    kind: str
    frame: int
    change: float
    found: bool


@dataclass(frozen=True)
class Step:
    """Error of a step in um and its U, NaN where the step was not measured."""

    error_um: float
    expanded_um: float


@dataclass(frozen=True)
class Judged:
    planted: tuple[Planted, ...]
    false_alarms: int
    sound_frames: int
    steps: dict[str, Step]


def sample_of(seed: int) -> Sample:
    rng = np.random.default_rng((seed, 31))
    na, step_dof, depth_um = float(rng.uniform(0.20, 0.45)), float(rng.uniform(0.25, 0.75)), float(rng.uniform(15, 40))
    dof_um = WAVELENGTH_UM / na**2
    scene = Bleeding(
        na=na, step_dof=step_dof, trench_px=TRENCH_PX, pitch_px=PITCH_PX, depth_um=depth_um,
        ratio=float(rng.uniform(1.0, 2.0)),
        die_contrast=float(rng.uniform(0.08, 0.3)), trench_contrast=float(rng.uniform(0.08, 0.3)),
        trench_grain_px=float(rng.uniform(0.8, 2.0)), bare_share=0.0, clipped=0.0,
        full_well_e=float(np.exp(rng.uniform(np.log(4e3), np.log(4e4)))), lines=True, seed=seed,
        sweep_um=max(float(rng.uniform(5, 10)) * dof_um, LEAST_FRAMES * step_dof * dof_um - depth_um),
    )  # fmt: skip
    z_um = np.arange(0.0, scene.depth_um + scene.sweep_um, scene.step_um)
    jitter_um, flicker = float(rng.uniform(0, MOST_JITTER_UM)), float(rng.uniform(0, MOST_FLICKER))
    layers = BlurredLayers(scene, SHAPE, rng)
    places = z_um + jitter_um * rng.standard_normal(len(z_um))
    light, jittered = (np.stack([layers.light_at(z) for z in at]).astype(np.float32) for at in (z_um, places))
    return Sample(scene, z_um, light, jittered, jitter_um, flicker, layers.truth_um)


def judge(seed: int) -> Judged:
    """Plant the faults of a scene and measure its step without and with them."""
    sample = sample_of(seed)
    rng = np.random.default_rng((seed, 32))
    gains = (1 + sample.flicker * rng.standard_normal(len(sample.z_um))).clip(0.5, 1.5).astype(np.float32)
    flickering = sample.stack(sample.light * gains[:, None, None])
    faulty, planted = with_faults(sample, rng)
    stacks = {
        "sound": (sample.stack(sample.light), "correct"),
        "flicker, not corrected": (flickering, "none"),
        "flicker, corrected": (flickering, "correct"),
        "z jitter": (sample.stack(sample.jittered), "correct"),
        "five faulty frames, left out where found": (faulty, "correct"),
    }
    steps = {name: step_of(sample, stack, flicker) for name, (stack, flicker) in stacks.items()}
    with without_frame_tests():
        steps["five faulty frames, all used"] = step_of(sample, faulty, "correct")
    named = frames_named(faulty)
    alarms = sum(len(frames_named(stacks[name][0])) for name in ("sound", "flicker, corrected", "z jitter"))
    alarms += len(named - {one.frame for one in planted})
    found = tuple(replace(one, found=one.frame in named) for one in planted)
    return Judged(found, alarms, 4 * len(sample.z_um) - len(planted), steps)


def with_faults(sample: Sample, rng: np.random.Generator) -> tuple[FieldStack, tuple[Planted, ...]]:
    """A stack with one fault of each kind, each in a frame of its own."""
    light, rows = sample.light.copy(), sample.light.shape[1]
    flash, black, blank, stale, slipped = rng.choice(np.arange(1, len(light) - 1), len(KINDS), replace=False).tolist()
    light[flash] += np.float32(rng.uniform(0.5, 2.0))
    light[black] = 0.0
    light[blank] = light[blank].mean()
    stack = sample.stack(light)
    found = [Planted(kind, k + 1, np.inf, False) for kind, k in zip(KINDS, (flash, black, blank), strict=False)]
    sources = (stale + int(rng.choice([-1, 1]) * rng.integers(1, 6))) % len(light), slipped
    offsets = 0, int(rng.choice([-1, 1]) * rng.integers(2, 40))
    original = stack.images.copy()
    for kind, k, source, offset in zip(TEARS, (stale, slipped), sources, offsets, strict=True):
        top, high = int(rng.integers(0, rows // 2)), int(rng.integers(rows // 8, rows // 2))
        band = slice(top, top + high)
        stack.images[k, band] = np.roll(original[source, band], offset, axis=1)
        off = np.roll(light[source, band], offset, axis=1) - light[k, band]
        noise = np.sqrt(light[k, band] / sample.scene.full_well_e + (0.4 / 255) ** 2)
        found.append(Planted(kind, k + 1, float(np.sqrt(np.mean((off / noise) ** 2))), False))
    return stack, tuple(found)


def frames_named(stack: FieldStack) -> set[int]:
    """Numbers of the frames that are left out, from 1."""
    told = (re.match(r"Frame (\d+) of .*left out", note) for note in frames_module.prepare(stack).notes)
    return {int(one[1]) for one in told if one}


@contextmanager
def without_frame_tests() -> Iterator[None]:
    """Use every frame, as if none were tested."""
    with mock.patch.object(frames_module, "_sound_slots", lambda stack, slots, white, clipped: (slots, ())):
        yield


def step_of(sample: Sample, stack: FieldStack, flicker: str) -> Step:
    """The step between the middles of die and trench."""
    height = reconstruct(stack, changed(Recipe(), flicker=flicker), threads=1)
    high = sample.truth_um[0] > sample.truth_um.min() + sample.scene.depth_um / 2
    x0, y0, x1, y1 = height.bounds_um
    faces = []
    for face in (high, ~high):
        first, last = _longest_run(face)
        left, right = (x0 + (x1 - x0) * edge / len(high) for edge in (first + WALL_PX, last - WALL_PX))
        faces.append(Region.rectangle(left, y0 + 3, right, y1 - 3))
    try:
        found = step_height(height, *faces).height
    except WaferViewerError:
        return Step(np.nan, np.nan)
    expanded = found.quantity.expanded
    return Step(found.value_um - sample.scene.depth_um, np.nan if expanded is None else expanded)


def _longest_run(face: NDArray[np.bool_]) -> tuple[int, int]:
    """(first, one after the last) of the longest run."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], face, [False]]).astype(int)))
    runs = edges.reshape(-1, 2)
    first, last = runs[np.argmax(runs[:, 1] - runs[:, 0])]
    return int(first), int(last)


def main() -> None:
    wanted = read_options(__doc__, scenes=SCENES, first_seed=FIRST_REPORTED_SEED)
    count = QUICK_SCENES if wanted.quick else wanted.scenes
    with ProcessPoolExecutor() as pool:
        scenes = list(pool.map(judge, range(wanted.first_seed, wanted.first_seed + count)))
    show_found(scenes)
    show_steps(scenes)


def show_found(scenes: Sequence[Judged]) -> None:
    planted = [one for scene in scenes for one in scene.planted]
    rows = [_found_row(kind, [one for one in planted if one.kind == kind]) for kind in KINDS]
    for kind in TEARS:
        for low, high in CHANGES:
            some = [one for one in planted if one.kind == kind and low <= one.change < high]
            rows.append(_found_row(f"  {kind}, change of {low:g} to {high:g} times the noise", some))
    show(f"Faulty frames of {len(scenes)} scenes", ("fault", "planted", "found", "missed", "found %"), rows)
    alarms, sound = (sum(getattr(scene, name) for scene in scenes) for name in ("false_alarms", "sound_frames"))
    print(f"False alarms: {alarms} of {sound} sound frames, sound, flickering, jittering and beside faulty ones")


def _found_row(name: str, some: Sequence[Planted]) -> tuple[str | int, ...]:
    found = sum(one.found for one in some)
    return name, len(some), found, len(some) - found, percent(found / len(some) if some else float("nan"))


def show_steps(scenes: Sequence[Judged]) -> None:
    rows = []
    for name in scenes[0].steps:
        error, expanded = np.array([(s.steps[name].error_um, s.steps[name].expanded_um) for s in scenes]).T
        known = np.isfinite(error)
        off = np.abs(error[known])
        covered = np.mean(off <= expanded[known]) if known.any() else np.nan
        errors = (np.sqrt(np.mean(off**2)), np.median(off), off.max(), np.median(expanded[known])) if len(off) else ()
        rows.append((name, len(off), *map(float, errors or (np.nan,) * 4), percent(covered)))
    header = ("stack", "measured", "rms error um", "median", "largest", "median U um", "U covers %")
    show("Step between two level faces, SIMULATED", header, rows)


if __name__ == "__main__":
    main()
