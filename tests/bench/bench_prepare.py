"""What it costs and what it brings to put a stack right before it is measured: flaws, drift, exposures.

    python tests/bench/bench_prepare.py [--quick | --flaws]

Flaws are a white pixel, column or row of the sensor. Drift is planted in what the virtual microscope sees of its
scenes, before the sensor: lateral, even or in jumps, and as growth. `found off` is the largest error over the frames in
which something sharp was seen. Heights are against the truth; the whole map is moved by its median, and a height more
than 4 um off is false. Cost is processor time on one thread for a field of 1440 x 1080, of which every part is another
part of the sample.
"""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import affine_transform

from tests.bench.harness import highest, read_options, took
from tests.reconstruct.conftest import correction
from wafer_viewer.model.acquisition.focus_stack import Bracket, FieldStack
from wafer_viewer.model.acquisition.plan import Field
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.reconstruct.field_pipeline import reconstruct
from wafer_viewer.reconstruct.focus.peak_search import STRIPE_ROWS
from wafer_viewer.reconstruct.frame_blocks import Frames, developed, read_part, stripes
from wafer_viewer.reconstruct.preprocess.drift import Drift
from wafer_viewer.reconstruct.preprocess.frames import prepare
from wafer_viewer.rigs.virtual.camera import Sensor
from wafer_viewer.rigs.virtual.optics.optics import FieldPicture, Optics
from wafer_viewer.rigs.virtual.scenes.catalogue import SCENES

ROWS, COLS, MARGIN, PIXEL_UM, FALSE_UM = 480, 660, 30, 0.46729, 4.0
ORIGIN_FIELD = Field(number=1, row=0, col=0, x_um=0.0, y_um=0.0, z_start_um=0.0)
LEFT_ALONE = Recipe(drift="none")
GAINS = ((0.5, 1), (0.5, 2), (0.5, 4))
"""Of the short exposure and the long one."""
QUICK = ("1 px", "growth 1 %")
Floats = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Seen:
    """The light of a scene with a margin round the frame, [k, row, col], and its truth within the frame."""

    light: NDArray[np.float32]
    z_um: Floats
    truth_um: Floats
    gain: float


def main() -> None:
    told = read_options(__doc__, flaws=False)
    if not told.quick:
        report_flaws(60)
    if not told.flaws:
        report_all(told.quick)


def report_all(quick: bool) -> None:
    for name in ("plane",) if quick else SCENES:
        seen = look(name)
        report_drift(name, seen, QUICK if quick else None)
        report_exposures(name, seen, GAINS[:1] if quick else GAINS)
    report_cost(12 if quick else 126)


def look(name: str) -> Seen:
    scene = SCENES[name]
    z_um = scene.tour_z_start_um + scene.tour_z_step_um * np.arange(scene.tour_frames)
    size = ROWS + 2 * MARGIN, COLS + 2 * MARGIN
    field = FieldPicture(scene, Optics(), *scene.tour_center_um, *size, (float(z_um[0]), float(z_um[-1])))
    light = np.stack([field.radiance(z) for z in z_um])
    return Seen(light, z_um, field.truth()[MARGIN:-MARGIN, MARGIN:-MARGIN], scene.gain)


def report_drift(name: str, seen: Seen, only: tuple[str, ...] | None = None) -> None:
    """Of all drifts that are planted, or `only` these."""
    n = len(seen.z_um)
    even, none = np.linspace(-0.5, 0.5, n), np.zeros(n)
    rng = np.random.default_rng(3)
    jumps = 2 * np.cumsum(rng.normal(0, 1, n) * (rng.random(n) < 0.15))
    planted = {"still": (none, none), "0.3 px": (0.3 * even, none), "1 px": (even, none), "3 px": (3 * even, none)}
    planted |= {"20 px": (20 * even, none), "jumps": (jumps, none), "growth 0.1 %": (none, 0.001 * even)}
    planted["growth 1 %"] = (none, 0.01 * even)
    for what in only or planted:
        shift_px, growth = planted[what]
        stack = stack_of(seen, shot(seen, shift_px, growth))
        frames = prepare(stack)
        left, right = (judged(reconstruct(stack, r), seen.truth_um) for r in (LEFT_ALONE, Recipe()))
        print(f"{name:12s} {what:12s} {found(frames, shift_px, growth):42s} left alone {left} | put right {right}")


def report_exposures(name: str, seen: Seen, pairs: tuple[tuple[float, float], ...]) -> None:
    still = np.zeros(len(seen.z_um))
    for gains in pairs:
        one, other = (shot(seen, still, still, gain, seed) for seed, gain in enumerate(gains))
        bracket = Bracket(other, np.ones(len(other), bool), 100 * gains[1])
        stack = dataclasses.replace(stack_of(seen, one), exposure_us=100 * gains[0], brackets=(bracket,))
        alone = [judged(reconstruct(stack_of(seen, images)), seen.truth_um) for images in (one, other)]
        fused = judged(reconstruct(stack), seen.truth_um)
        print(f"{name:12s} exposures x{gains[1] / gains[0]:g}: short {alone[0]} | long {alone[1]} | fused {fused}")


def report_flaws(n_frames: int) -> None:
    """Of a field in which one pixel, column or row is hot: mapped from a file, as a dataset is."""
    hot = {"no flaw": None, "hot pixel": np.s_[500, 700], "hot column": np.s_[:, 700], "hot row": np.s_[500, :]}
    with tempfile.TemporaryDirectory() as folder:
        stack = whole_field(Path(folder), n_frames)
        for what, where in hot.items():
            one = stack if where is None else dataclasses.replace(stack, images=heated(Path(folder), where))
            frames = prepare(one, LEFT_ALONE)
            reading = least_ms(lambda f=frames: read_for_search(f)) / n_frames
            whole = least_ms(lambda s=one: reconstruct(s, LEFT_ALONE, threads=1)) / n_frames
            print(f"{what:12s} reading for the search {reading:6.3f} ms a frame, reconstruction {whole:.2f} ms a frame")


def report_cost(n_frames: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        stack = whole_field(Path(folder), n_frames)
        plain = least_ms(lambda: prepare(stack, LEFT_ALONE))
        print(
            f"field of {n_frames} frames: flaws {plain:.0f} ms, drift {least_ms(lambda: prepare(stack)) - plain:.0f} ms"
        )
        bracket = Bracket(stack.images, stack.present)
        even = np.linspace(-1.5, 1.5, n_frames)
        frames = prepare(stack)
        drift = Drift(np.stack([even, even], axis=1), np.zeros(n_frames), frames.shape)
        fused = prepare(dataclasses.replace(stack, brackets=(bracket,)), LEFT_ALONE)
        for what, one in (
            ("plain", frames),
            ("drifted", dataclasses.replace(frames, corrections=(drift,))),
            ("fused", fused),
        ):
            print(f"reading, {what}: {least_ms(lambda f=one: read_all(f)) / n_frames:.2f} ms a frame")
        both = dataclasses.replace(stack, brackets=(bracket,))
        with highest() as most_mb:
            reconstruct(both, threads=1)
        print(f"two exposures, one thread: own memory {most_mb[0]:.0f} MB at most")


def shot(seen: Seen, shift_px: Floats, growth: Floats, exposure: float = 1.0, seed: int = 0) -> NDArray[np.uint8]:
    """The frames of a camera that drifts along rows, half as far along columns, and whose picture grows."""
    sensor, middle = Sensor(ROWS, COLS), np.array([(ROWS - 1) / 2, (COLS - 1) / 2])
    frames: list[NDArray[np.uint8]] = []
    for k, light in enumerate(seen.light):
        scale = 1 / (1 + growth[k])
        offset = MARGIN + middle - scale * (middle + shift_px[k] * np.array([1, 0.5]))
        picture = affine_transform(light, [scale, scale], offset, (ROWS, COLS), order=3, mode="nearest")
        frames.append(sensor.expose(np.ascontiguousarray(picture), seen.gain * exposure, 1000 * seed + k))
    return np.stack(frames)


def stack_of(seen: Seen, images: NDArray[np.uint8]) -> FieldStack:
    return FieldStack(ORIGIN_FIELD, images, seen.z_um, np.ones(len(images), bool), PIXEL_UM)


def found(frames: Frames, shift_px: Floats, growth: Floats) -> str:
    """What was found, and how far off it is at the field's corner where the frames were seen."""
    drift = correction(frames, Drift)
    if drift is None:
        return "nothing found"
    moved = np.flatnonzero(np.abs(np.diff(drift.shift_px[:, 0])) + np.abs(np.diff(drift.growth)) > 1e-9)
    seen = slice(moved[0], moved[-1] + 2)
    off = np.stack([drift.shift_px[:, 0] - shift_px, drift.shift_px[:, 1] - 0.5 * shift_px], axis=1)[seen]
    grown = ((drift.growth - growth) * np.hypot(ROWS, COLS) / 2)[seen]
    shift_off, grown_off = (float(np.abs(o - o.mean(axis=0)).max()) for o in (off, grown))
    return f"found in {len(off)} frames off {shift_off:.2f}, {grown_off:.2f} px"


def judged(height: HeightMap, truth_um: Floats) -> str:
    error = (height.z_raw_um - truth_um)[height.measured]
    if not error.size:
        return "nothing measured"
    error = error - np.median(error)
    right = np.abs(error) <= FALSE_UM
    rmse_um = float(np.sqrt(np.mean(error[right] ** 2)))
    return f"{height.measured.mean():.1%} measured, {1 - right.mean():.2%} false, RMSE {rmse_um:.3f} um"


def whole_field(folder: Path, n_frames: int) -> FieldStack:
    """A full-size stack of the wafer in a file, no part of it like another."""
    scene, sensor = SCENES["wafer"], Sensor(1080, 1440)
    z_um: Floats = -40.0 + 4.0 * np.arange(n_frames, dtype=np.float64)
    field = FieldPicture(scene, Optics(), *scene.tour_center_um, 1080, 1440, (float(z_um[0]), float(z_um[-1])))
    images = np.lib.format.open_memmap(folder / "field.npy", "w+", np.uint8, (n_frames, 1080, 1440))
    for k, z in enumerate(z_um):
        images[k] = sensor.expose(field.radiance(z), scene.gain, k)
    images.flush()
    mapped = np.load(folder / "field.npy", mmap_mode="r")
    return FieldStack(ORIGIN_FIELD, mapped, z_um, np.ones(n_frames, bool), PIXEL_UM)


def heated(folder: Path, where: tuple[int | slice, int | slice]) -> NDArray[np.uint8]:
    """The same stack, the pixels `where` white in every frame: the pages that change are copied, the others mapped."""
    private: NDArray[np.uint8] = np.load(folder / "field.npy", mmap_mode="c")
    private[:, *where] = 255
    return private


def read_for_search(frames: Frames) -> None:
    """All stripes of a field, where the search reads them."""
    for _ in developed(frames, stripes(frames.shape, STRIPE_ROWS), 7):
        pass


def read_all(frames: Frames) -> None:
    """All blocks of a field, as a search reads them."""
    for part in stripes(frames.shape, 48):
        read_part(frames, part, 5)


def least_ms(work: Callable[[], object]) -> float:
    """Processor time of the quickest of five runs."""
    return 1e3 * took(work, 5).processor_s


if __name__ == "__main__":
    main()
