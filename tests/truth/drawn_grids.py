"""Grids of fields drawn from a distribution by seed: what stitching is tuned on (seeds below 1000) and judged by.

Random texture, dies that repeat every 10 to 200 px with and without dust, and lines; uneven light; stages with
backlash, drift, turn and scale; missing fields, fields that do not belong, blank ground. No seed draws a lens that
distorts or an overlap that is not the stated one; tests plant both. The pictures are sampled from smooth pictures of
the whole by cubic splines, so that every place between two pixels has a true value.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates, spline_filter

from tests.support.surfaces import height_map
from wafer_viewer.model.surface.height_map import HeightMap

Floats = NDArray[np.float64]
Kind = Literal["random", "dies", "dusty dies", "lines"]
PIXEL_UM = 0.5
CHANCES: dict[Kind, float] = {"random": 0.25, "dies": 0.35, "dusty dies": 0.25, "lines": 0.15}
STAGE_OF_PITCH = 0.16
"""Largest deviation of the stage from where it is told to go, of the pitch; coarser stages are drawn apart."""
MARGIN_PX = 48
SMOOTH_PX = 1.0


@dataclass(frozen=True, slots=True)
class DrawnGrid:
    """What a seed stands for; lengths in pixels, light in fractions of full brightness, noise in counts.

    stage_px: deviation of a field's place along an axis; backlash_px: of every second row along x; drift_px: of the
    last field against the first; turn (rad) and scale (fraction): of the stage against the camera; fall_off: of the
    light in the middle of an edge, twice as much in a corner; off_centre: of the brightest place, in half fields;
    dust: spots per field; blank: share of the ground without anything to see; misfits: number of field to what is
    wrong with it; distortion: of the third order, the fraction by which a corner lies too far from the axis of the lens
    at `lens_at`, in half fields; stated_overlap: by which the places of the fields were made up, None without a doubt.
    """

    seed: int
    kind: Kind
    rows: int
    cols: int
    shape: tuple[int, int]
    overlap: float
    pitch_px: tuple[float, float]
    angle: float
    stage_px: float
    backlash_px: float
    drift_px: float
    turn: float
    scale: float
    fall_off: float
    off_centre: tuple[float, float]
    gain_sd: float
    dust: float
    blank: float
    noise: float
    missing: tuple[int, ...]
    misfits: tuple[tuple[int, str], ...]
    distortion: float = 0.0
    lens_at: tuple[float, float] = (0.0, 0.0)
    stated_overlap: float | None = None

    @property
    def periodic(self) -> bool:
        """Whether the ground repeats along both axes."""
        return "dies" in self.kind

    @property
    def stage_of_pitch(self) -> float:
        """Scatter of the stage as a share of the finer pitch; 0 where nothing repeats."""
        scatter = float(np.hypot(self.stage_px, self.backlash_px / 2))
        return scatter / min(self.pitch_px) if self.periodic else 0.0


_PLANTED: dict[str, Any] = {"kind": "dies", "rows": 16, "cols": 13, "shape": (300, 400), "overlap": 0.12, "angle": 0.0}
_PLANTED |= {"pitch_px": (170.0, 170.0), "stage_px": 3.0, "backlash_px": 6.0, "drift_px": 0.0, "turn": 3.5e-3}
_PLANTED |= {"scale": 0.0, "fall_off": 0.075, "off_centre": (0.0, 0.0), "gain_sd": 0.0, "dust": 0.0, "blank": 0.0}
_PLANTED |= {"noise": 3.0}
_SMALL: dict[str, Any] = {"rows": 40, "cols": 40, "shape": (200, 260)}
_FINE: dict[str, Any] = {"pitch_px": (30.0, 30.0), "stage_px": 3.0, "backlash_px": 4.0}
SCENES: dict[str, dict[str, Any]] = {
    "random, 16 x 13": {"kind": "random"},
    "dies of 170 px, 16 x 13": {},
    "the same, light falls off by 15 / 30 %": {"fall_off": 0.15},
    "dies of 30 px, 16 x 13": _FINE,
    "random, 40 x 40 of 200 x 260": {"kind": "random", **_SMALL},
    "dies of 30 px, 40 x 40 of 200 x 260": _FINE | _SMALL,
}
"""Grids of many fields by name, and what is different from `planted`; stages of fine dies within `STAGE_OF_PITCH`."""


@dataclass(frozen=True, slots=True, eq=False)
class MadeGrid:
    """Fields of a drawn grid as the stitcher gets them, [n], and where they truly are, (x, y) [n, 2] in um.

    True places are in the axes of the camera. misfits: index in the list to what is wrong. clean: grey of each field
    without noise.
    """

    drawn: DrawnGrid
    heights: tuple[HeightMap, ...]
    true_um: Floats
    stage_um: Floats
    misfits: dict[int, str]
    clean: tuple[NDArray[np.float32], ...]


def narrowed(grid: DrawnGrid) -> DrawnGrid:
    """Return the same grid with fields that overlap by 4 to 7 %, at least 10 px."""
    rng = np.random.default_rng((6, grid.seed))
    return replace(grid, overlap=max(float(rng.uniform(0.04, 0.07)), 10 / min(grid.shape)))


def drawn(seed: int) -> DrawnGrid:
    """Return what a seed stands for."""
    rng = np.random.default_rng((2, seed))
    kind: Kind = rng.choice(list(CHANCES), p=list(CHANCES.values()))
    rows, cols = (int(n) for n in rng.integers(3, 8, 2))
    shape = int(rng.integers(180, 320)), int(rng.integers(240, 420))
    overlap = max(float(rng.uniform(0.06, 0.2)), 24 / min(shape))
    coarse = 200.0 if rng.random() < 0.5 else 60.0
    pitch = float(np.exp(rng.uniform(np.log(10.0), np.log(coarse))))
    aspect = float(rng.choice([1.0, rng.uniform(0.7, 1.4)]))
    stage = float(rng.uniform(0.5, 6.0))
    backlash = float(rng.choice([0.0, 0.0, rng.uniform(0, 8.0)]))
    scatter = float(np.hypot(stage, backlash / 2))
    if "dies" in kind:
        most = STAGE_OF_PITCH * pitch * min(1.0, aspect)
        share = min(1.0, most * float(rng.uniform(0.3, 1.0)) / scatter)
        stage, backlash = stage * share, backlash * share
    n = rows * cols
    odd = rng.permutation(n)
    n_missing, n_wrong = (int(rng.integers(1, 3)) if rng.random() < chance else 0 for chance in (0.25, 0.35))
    what = str(rng.choice(["foreign", "mirrored", "turned", "swapped"]))
    wrong = odd[n_missing : n_missing + (2 if what == "swapped" else 1) * bool(n_wrong)] if n >= 16 else odd[:0]
    return DrawnGrid(
        seed=seed,
        kind=kind,
        rows=rows,
        cols=cols,
        shape=shape,
        overlap=overlap,
        pitch_px=(pitch, pitch * aspect),
        angle=float(rng.choice([0.0, rng.uniform(-0.02, 0.02)])) + (float(rng.uniform(0, np.pi)) * (kind == "lines")),
        stage_px=stage,
        backlash_px=backlash,
        drift_px=float(rng.choice([0.0, rng.uniform(-1, 1) * scatter])),
        turn=float(rng.choice([0.0, rng.normal(0, 1.5e-3)])),
        scale=float(rng.choice([0.0, rng.normal(0, 5e-4)])),
        fall_off=float(rng.uniform(0, 0.15)),
        off_centre=(float(rng.uniform(-0.3, 0.3)), float(rng.uniform(-0.3, 0.3))),
        gain_sd=float(rng.choice([0.0, 0.05])),
        dust=float(rng.uniform(8, 40)) if kind == "dusty dies" else 0.0,
        blank=float(rng.choice([0.0, 0.0, rng.uniform(0, 0.2)])),
        noise=float(np.exp(rng.uniform(np.log(0.7), np.log(6.0)))),
        missing=tuple(int(k) for k in odd[:n_missing]) if n >= 12 else (),
        misfits=tuple((int(k), what) for k in wrong),
    )


def planted(name: str, seed: int) -> DrawnGrid:
    """Return a grid of `SCENES`: 1 of 40 fields is missing, two are swapped, one is of another sample.

    Dies under light that falls off by 7.5 % at edges and 15 % in corners; a camera turned by .2 degrees; a stage that
    errs by 3 px, and by 6 px more in every second row.
    """
    grid = replace(drawn(seed), **_PLANTED)
    grid = replace(grid, **SCENES[name])
    odd = [int(k) for k in np.random.default_rng((5, seed)).permutation(grid.rows * grid.cols)]
    what = ("swapped", "swapped", "foreign")
    return replace(grid, misfits=tuple(zip(odd[:3], what, strict=True)), missing=tuple(odd[3 : 3 + len(odd) // 40]))


def made(grid: DrawnGrid) -> MadeGrid:
    """Return the fields of a grid, with their pictures and heights."""
    rng = np.random.default_rng((3, grid.seed))
    true, stage = _places(grid, rng)
    size = np.ceil(true.max(axis=0)) + np.array(grid.shape[::-1]) + 2 * MARGIN_PX
    ground = _Ground(grid, (int(size[1]), int(size[0])), rng)
    misfits = dict(grid.misfits)
    swapped = [k for k, what in grid.misfits if what == "swapped"]
    seen_at = dict(zip(swapped, swapped[::-1], strict=True))
    kept = [k for k in range(grid.rows * grid.cols) if k not in grid.missing]
    heights, clean, light = [], [], _light(grid)
    room = grid.shape[0] + 2 * MARGIN_PX, grid.shape[1] + 2 * MARGIN_PX
    foreign = _Ground(grid, room, np.random.default_rng((4, grid.seed)), other=True)
    for k in kept:
        what = misfits.get(k, "")
        one, at = (foreign, np.zeros(2)) if what == "foreign" else (ground, true[seen_at.get(k, k)])
        grey = one.seen(at, grid.shape) * light * (1 + grid.gain_sd * rng.standard_normal())
        clean.append(_held(grey, what).astype(np.float32))
        grey = grey + grid.noise * rng.standard_normal(grid.shape)
        heights.append(_height_map(_held(grey, what), stage[k], grid.shape, rng))
    index = {k: n for n, k in enumerate(kept)}
    at_um = true[kept] * (PIXEL_UM, -PIXEL_UM)
    odd = {index[k]: what for k, what in grid.misfits}
    return MadeGrid(grid, tuple(heights), at_um, stage[kept] * (PIXEL_UM, -PIXEL_UM), odd, tuple(clean))


def _places(grid: DrawnGrid, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return where fields are and where the stage says they are: upper left corners (x, y), y downwards, px."""
    rows, cols = (n.ravel() for n in np.indices((grid.rows, grid.cols)))
    step = np.array(grid.shape[::-1]) * (1 - grid.overlap)
    asked = np.column_stack((cols, rows)) * step
    order = np.where(rows % 2, rows * grid.cols + grid.cols - 1 - cols, rows * grid.cols + cols) / max(1, len(rows) - 1)
    off = rng.normal(0, grid.stage_px, asked.shape)
    off[:, 0] += grid.backlash_px * (rows % 2) + grid.drift_px * order
    off[:, 1] += grid.drift_px * order * 0.5
    arm = asked - asked.mean(axis=0)
    off += grid.scale * arm + grid.turn * np.column_stack((arm[:, 1], -arm[:, 0]))
    true = asked + off
    shift = MARGIN_PX - true.min(axis=0)
    if grid.stated_overlap is not None:
        asked = asked * (1 - grid.stated_overlap) / (1 - grid.overlap)
    return true + shift, asked + shift


def _light(grid: DrawnGrid) -> Floats:
    """Return the share of light at each pixel of a field."""
    v, u = (np.linspace(-1, 1, n) - c for n, c in zip(grid.shape, grid.off_centre, strict=True))
    return 1 - grid.fall_off * (u[None, :] ** 2 + v[:, None] ** 2)


class _Ground:
    """The sample in pixels of the camera: a cell that repeats, and what is there once only."""

    def __init__(self, grid: DrawnGrid, shape: tuple[int, int], rng: np.random.Generator, other: bool = False) -> None:
        self.grid, self.cell = grid, None
        once = np.zeros(shape, np.float32)
        if grid.kind == "random":
            once += _texture(shape, 1.6, 14.0, rng) + _texture(shape, 7.0, 12.0, rng) + _texture(shape, 30.0, 10.0, rng)
        if grid.kind == "lines":
            self.stripes = spline_filter(gaussian_filter(_steps(4096, rng) * 30, 1.6, mode="wrap"), mode="grid-wrap")
        if grid.periodic:
            pitch = grid.pitch_px if not other else tuple(p * float(rng.uniform(1.2, 1.5)) for p in grid.pitch_px)
            self.pitch, self.cell = pitch, spline_filter(_cell(pitch, rng), mode="grid-wrap")
        if grid.dust:
            once += _dust(shape, grid, rng)
        if grid.blank:
            keep = _texture(shape, 40.0, 1.0, rng)
            self.keep = np.clip(0.5 + 4 * (keep - np.quantile(keep, grid.blank)), 0, 1).astype(np.float32)
        else:
            self.keep = None
        self.once = spline_filter(once, mode="mirror")

    def seen(self, at: Floats, shape: tuple[int, int]) -> Floats:
        """Return what a field at (x, y) sees, grey in counts."""
        y, x = np.meshgrid(at[1] + np.arange(shape[0]), at[0] + np.arange(shape[1]), indexing="ij")
        if self.grid.distortion:
            half_px = (np.array(shape[::-1]) - 1) / 2
            from_axis = np.stack((x, y), -1) - at - half_px * (1 + np.array(self.grid.lens_at))
            further = self.grid.distortion * np.sum(from_axis**2, axis=-1) / np.sum(half_px**2)
            x, y = x - further * from_axis[..., 0], y - further * from_axis[..., 1]
        detail = map_coordinates(self.once, (y, x), order=3, mode="mirror", prefilter=False).astype(float)
        cos, sin = np.cos(self.grid.angle), np.sin(self.grid.angle)
        u, v = cos * x + sin * y, cos * y - sin * x
        if self.cell is not None:
            rows, cols = self.cell.shape
            places = v / self.pitch[1] % 1 * rows, u / self.pitch[0] % 1 * cols
            detail += map_coordinates(self.cell, places, order=3, mode="grid-wrap", prefilter=False)
        if self.grid.kind == "lines":
            detail += map_coordinates(self.stripes, (v % 4096,), order=3, mode="grid-wrap", prefilter=False)
        if self.keep is not None:
            detail *= map_coordinates(self.keep, (y, x), order=1, mode="nearest")
        return 100 + detail


def _texture(shape: tuple[int, int], grain_px: float, sd: float, rng: np.random.Generator) -> NDArray[np.float32]:
    """Return smooth random grey with mean 0."""
    plane = gaussian_filter(rng.standard_normal(shape, np.float32), grain_px, mode="wrap")
    return plane * np.float32(sd / plane.std())


def _steps(n: int, rng: np.random.Generator) -> Floats:
    """Return stripes of random widths and greys."""
    out, at = np.empty(n), 0
    while at < n:
        width = int(rng.integers(4, 40))
        out[at : at + width] = rng.uniform(-1, 1)
        at += width
    return out


def _cell(pitch: tuple[float, float], rng: np.random.Generator) -> NDArray[np.float32]:
    """Return one die with its street, pads and tracks, smooth over its borders."""
    cols, rows = (max(8, round(p)) for p in pitch)
    plane = np.full((rows, cols), -25.0)
    inner = plane[max(1, rows // 9) :, max(1, cols // 9) :]
    inner[:] = 15.0
    for _ in range(int(rng.integers(2, 8))):
        height, width = (int(rng.integers(1, max(2, n // 2))) for n in inner.shape)
        r, c = int(rng.integers(0, inner.shape[0] - height + 1)), int(rng.integers(0, inner.shape[1] - width + 1))
        inner[r : r + height, c : c + width] += rng.uniform(-40, 40)
    return gaussian_filter(plane, SMOOTH_PX, mode="wrap").astype(np.float32)


def _dust(shape: tuple[int, int], grid: DrawnGrid, rng: np.random.Generator) -> NDArray[np.float32]:
    """Return dark and bright spots, each there once only."""
    n = int(grid.dust * shape[0] * shape[1] / (grid.shape[0] * grid.shape[1]))
    plane = np.zeros(shape, np.float32)
    plane[rng.integers(0, shape[0], n), rng.integers(0, shape[1], n)] = rng.uniform(-1, 1, n) * 25 * 2 * np.pi * 4
    return gaussian_filter(plane, 2.0)


def _held(grey: Floats, what: str) -> Floats:
    return grey[:, ::-1] if what == "mirrored" else grey[::-1, ::-1] if what == "turned" else grey


def _height_map(grey: Floats, stage_px: Floats, shape: tuple[int, int], rng: np.random.Generator) -> HeightMap:
    z = rng.normal(0, 0.3, shape).astype(np.float32)
    seen, (x0_um, y0_um) = np.clip(np.rint(grey), 0, 255).astype(np.uint8), stage_px * (PIXEL_UM, -PIXEL_UM)
    return height_map(z, PIXEL_UM, float(x0_um), float(y0_um), grey=seen, confidence=0.8, simulated=True)
