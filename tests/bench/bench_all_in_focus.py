"""All-in-focus pictures beside those of focus stackers, on scenes drawn by seed and on photographs.

    python tests/bench/bench_all_in_focus.py [--quick] [--scenes N] [--from SEED] [--photographs FOLDER]

Drawn scenes have no faults of their frames, and their truth is the light of each pixel with the focus at its height:
RMS error in grey levels of 255, and gradient energy over that of the truth, on pixels that we measure and on others.
The photographs have no truth. A pixel is lost where the gradient energy about it is under half of that in the frame
where it is largest, and invented where it is over one and a half times that: contours, halos and noise. They are
aligned once, for all programs alike, because focusing a photographic lens changes the magnification.

Of tiles of 32 px, those count in which ours is worse than another picture by more than a grey level. Families of
samples (`tests/truth/families.py`) stand beside the drawn scenes, a third as many of each.

Programs that are not installed are skipped with the line that installs them. --quick: three small scenes, and the
middle of the photographs. Tuning sees seeds below 1000.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import uniform_filter

from tests.bench.harness import percent, read_options, show, took
from tests.bench.peers import INSTALL_OPENCV, PICTURE_PEERS, importable
from tests.support.paths import ROOT
from tests.truth.families import FAMILIES, FamilyScene, family_scene
from tests.truth.unseen import FIRST_REPORTED_SEED, Unseen, drawn_scene
from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.acquisition.plan import Field
from wafer_viewer.model.surface.height_map import UNMEASURED_FROM
from wafer_viewer.reconstruct.field_pipeline import prepare_field, reconstruct, search_peaks

PHOTOGRAPHS = ROOT.parent / "shared" / "data" / "pcb-stack"
QUICK_SCENES, QUICK_SIDE, SIDE = 3, 128, 256
AROUND_PX = 5
LEAST_ENERGY = 4.0
"""Gradient energy in grey levels squared that noise and rounding may make or remove."""
LOST, INVENTED = 0.5, 1.5
OURS, TILE_PX, WORSE_GREY = "ours, with heights", 32, 1.0


class Made(NamedTuple):
    """A picture, and the milliseconds it took per frame and megapixel."""

    picture: NDArray
    ms: float


Maker = Callable[[FieldStack], Made]


def main() -> None:
    wanted = read_options(__doc__, scenes=24, first_seed=FIRST_REPORTED_SEED, photographs=PHOTOGRAPHS)
    for name, peer in PICTURE_PEERS.items():
        if peer.missing:
            print(f"{name}: {peer.missing}")
    n = min(wanted.scenes, QUICK_SCENES) if wanted.quick else wanted.scenes
    side, first = QUICK_SIDE if wanted.quick else SIDE, wanted.first_seed
    reconstruct(drawn_scene(0, 64, faults=False).stack, threads=1)
    drawn("drawn scenes", (drawn_scene(seed, side, faults=False) for seed in range(first, first + n)))
    for family in () if wanted.quick else FAMILIES:
        drawn(family, (family_scene(family, seed) for seed in range(first, first + -(-n // 3))))
    photographed(wanted.photographs, wanted.quick)


def makers() -> dict[str, Maker]:
    """Ours, the plain choice of frames by the same focus measure, and the programs that are installed."""

    def by(make: Callable[[FieldStack], NDArray]) -> Maker:
        def timed(stack: FieldStack) -> Made:
            made = took(lambda: make(stack))
            return Made(made.result, _ms(stack, made.clock_s))

        return timed

    def peer(name: str) -> Maker:
        def run(stack: FieldStack) -> Made:
            found = PICTURE_PEERS[name].run(stack)
            return Made(found.all_in_focus, _ms(stack, found.seconds))

        return run

    ours = {
        OURS: by(lambda stack: reconstruct(stack, threads=1).all_in_focus),
        "sharpest frame of each pixel": by(sharpest),
    }
    return ours | {name: peer(name) for name, one in PICTURE_PEERS.items() if one.missing is None}


def sharpest(stack: FieldStack) -> NDArray:
    """The grey of each pixel in its sharpest frame."""
    field = prepare_field(stack)
    return field.frames.as_stored_counts(search_peaks(field, threads=1).all_in_focus)


def _ms(stack: FieldStack, seconds: float) -> float:
    return 1e3 * seconds / (stack.images.size / 1e6)


# -------------------------------------------------------------------------------------------------------- drawn scenes


class Errors(NamedTuple):
    """RMS error in grey levels, and gradient energy over that of the truth."""

    rms: float
    energy: float


NOTHING = Errors(np.nan, np.nan)


def drawn(name: str, scenes: Iterable[Unseen | FamilyScene]) -> None:
    """Error against the truth, on measured pixels and on the others, and tiles in which ours is worse."""
    found: dict[str, list[tuple[Errors, Errors, float]]] = {name: [] for name in makers()}
    worse: dict[str, list[NDArray[np.bool_]]] = {name: [] for name in found}
    for scene in scenes:
        unmeasured = reconstruct(scene.stack, threads=1).origin >= UNMEASURED_FROM
        made = {name: make(scene.stack) for name, make in makers().items()}
        ours = tile_errors(made[OURS].picture, scene.sharp_grey)
        for name, one in made.items():
            both = (errors(one.picture, scene.sharp_grey, where) for where in (~unmeasured, unmeasured))
            found[name].append((*both, one.ms))
            worse[name].append((ours > tile_errors(one.picture, scene.sharp_grey) + WORSE_GREY).ravel())
        print(f"{scene.about}: {percent(float(np.mean(~unmeasured)))} % measured", flush=True)
    header = (
        "picture", "RMS measured", "energy", "RMS unmeasured", "median", "energy", "ms a frame and Mpx",
        "ours worse, % of tiles",
    )  # fmt: skip
    title = f"{name}: RMS of grey, mean and median; gradient energy, median"
    tiles = {name: percent(float(np.concatenate(each).mean())) for name, each in worse.items()}
    show(title, header, [(name, *_summary(each), tiles[name]) for name, each in found.items()])


def tile_errors(picture: NDArray, truth: NDArray) -> NDArray[np.float64]:
    """RMS error of grey of each whole tile."""
    rows, cols = (n // TILE_PX for n in picture.shape)
    square = (picture.astype(float) - truth)[: rows * TILE_PX, : cols * TILE_PX] ** 2
    return np.sqrt(square.reshape(rows, TILE_PX, cols, TILE_PX).mean(axis=(1, 3)))


def _summary(each: list[tuple[Errors, Errors, float]]) -> tuple[float, ...]:
    measured, unmeasured = (np.array([one[n] for one in each]) for n in (0, 1))
    ms = float(np.median([one[2] for one in each]))
    means = _mean(measured[:, 0]), _mean(unmeasured[:, 0])
    energies, middle = [_median(values) for values in (measured[:, 1], unmeasured[:, 1])], _median(unmeasured[:, 0])
    return means[0], energies[0], means[1], middle, energies[1], ms


def _mean(values: NDArray) -> float:
    return float(np.nanmean(values)) if np.isfinite(values).any() else np.nan


def _median(values: NDArray) -> float:
    return float(np.nanmedian(values)) if np.isfinite(values).any() else np.nan


def errors(picture: NDArray, truth: NDArray, where: NDArray[np.bool_]) -> Errors:
    """Errors of a picture on some pixels; NaN where there are none."""
    if not where.any():
        return NOTHING
    rms = float(np.sqrt(np.mean((picture[where].astype(float) - truth[where]) ** 2)))
    return Errors(rms, float(gradient_energy(picture)[where].mean() / gradient_energy(truth)[where].mean()))


def gradient_energy(picture: NDArray) -> NDArray[np.float32]:
    """Squared difference from the next pixel along rows and columns, [row, col]; 0 beyond the border."""
    grey = picture.astype(np.float32)
    energy = np.zeros_like(grey)
    energy[:-1] += np.diff(grey, axis=0) ** 2
    energy[:, :-1] += np.diff(grey, axis=1) ** 2
    return energy


# --------------------------------------------------------------------------------------------------------- photographs


def photographed(folder: Path, quick: bool) -> None:
    """Detail lost and invented in pictures of a real stack."""
    files = sorted(folder.glob("*.jpg"))
    if not files:
        print(f"\nNo photographs in {folder}: name a folder by --photographs.")
        return
    if not importable("cv2")():
        print(f"\nPhotographs are aligned by OpenCV, which is not installed: {INSTALL_OPENCV}")
        return
    images = aligned([np.asarray(Image.open(file).convert("L")) for file in files])
    if quick:
        images = np.ascontiguousarray(images[:, 500:1000, 500:1200])
    field = Field(number=1, row=0, col=0, x_um=0.0, y_um=0.0, z_start_um=0.0)
    n = len(images)
    stack = FieldStack(field, images, np.arange(float(n)), np.ones(n, bool), 1.0)
    unmeasured = reconstruct(stack, threads=1).origin >= UNMEASURED_FROM
    largest = np.max([_around(image) for image in images], axis=0)
    rows = []
    for name, make in makers().items():
        made = make(stack)
        energy = _around(made.picture)
        lost = energy < LOST * largest - LEAST_ENERGY
        invented = energy > INVENTED * largest + LEAST_ENERGY
        shares = (float(mask[where].mean()) for where in (~unmeasured, unmeasured) for mask in (lost, invented))
        rows.append((name, *(percent(share, 2) for share in shares), made.ms))
    header = ("picture", "lost %", "invented %", "unmeasured: lost %", "invented %", "ms a frame and Mpx")
    show(f"{n} photographs of {folder.name}, {percent(float(np.mean(~unmeasured)))} % measured", header, rows)


def _around(picture: NDArray) -> NDArray[np.float32]:
    return uniform_filter(gradient_energy(picture), AROUND_PX)


def aligned(images: list[NDArray]) -> NDArray:
    """Frames [k, row, col] laid on the last one, whose field of view is the smallest, by affine maps.

    The maps are found between neighbours, at half resolution and less the finest detail.
    """
    import cv2

    cv2.setNumThreads(1)
    halves = [
        cv2.GaussianBlur(cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), (0, 0), 2)
        for image in images
    ]
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 60, 1e-6)
    steps = []
    for before, after in itertools.pairwise(halves):
        start = np.eye(2, 3, dtype=np.float32)
        _, step = cv2.findTransformECC(before, after, start, cv2.MOTION_AFFINE, stop, None, 5)
        steps.append(np.vstack([step, [0, 0, 1]]))
    to_full = np.diag([2.0, 2.0, 1.0])
    placed, back = [images[-1]], np.eye(3)
    for image, step in zip(images[-2::-1], steps[::-1], strict=True):
        back = np.linalg.inv(step) @ back
        where = (to_full @ back @ np.linalg.inv(to_full))[:2]
        flags = cv2.INTER_LANCZOS4 | cv2.WARP_INVERSE_MAP
        placed.append(cv2.warpAffine(image, where, image.shape[::-1], flags=flags, borderMode=cv2.BORDER_REPLICATE))
    inner = slice(4, -4)
    return np.stack(placed[::-1])[:, inner, inner].copy()


if __name__ == "__main__":
    main()
