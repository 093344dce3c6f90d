"""The scenes with a known height: smooth ones, steps, and dies beside bright trenches. The same seed, the same scene.

Every scene takes a seed and the shape of its frame. Heights are chosen for a sweep over `SWEEP_UM`, 101 frames.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tests.truth.scene import PIXEL_UM, TruthScene
from tests.truth.shapes import Array, blobs, grid_cells, lattice_um, patches, rounded_square, texture, turned

SWEEP_UM = 4.0 * np.arange(101)
STEP_SWEEP_UM = 4.0 * np.arange(126)
BLOCKS_STEP_UM = 399.88
"""The certified step of the paper's gauge blocks."""

_MIDDLE_UM = 201.3
MARGIN_PX = 290
"""How far beyond the frame light comes from: 300 um out of focus at NA 0.40, 450 um at NA 0.28."""
Shape = tuple[int, int]


def plane(
    seed: int, shape: Shape = (320, 320), tilt: float = 0.1, middle_um: float = _MIDDLE_UM, contrast: float = 0.4
) -> TruthScene:
    """A plane that rises by `tilt` along the columns, and by half of it up the rows."""
    down, right = _points(shape)
    return smooth_scene("plane", seed, shape, middle_um + tilt * right - tilt / 2 * down, contrast)


def cone(seed: int, shape: Shape = (320, 320), height_um: float = 60.0, contrast: float = 0.4) -> TruthScene:
    """A cone whose foot touches the border of the frame."""
    down, right = _points(shape)
    foot_um = min(shape) / 2 * PIXEL_UM
    return smooth_scene(
        "cone", seed, shape, 170 + height_um * np.maximum(0, 1 - np.hypot(down, right) / foot_um), contrast
    )


def cosine(seed: int, shape: Shape = (320, 320), height_um: float = 30.0, contrast: float = 0.4) -> TruthScene:
    """Waves along both axes, 100 um long, height_um from trough to crest."""
    down, right = _points(shape)
    waves = np.cos(2 * np.pi * down / 100) + np.cos(2 * np.pi * right / 100)
    return smooth_scene("cosine", seed, shape, _MIDDLE_UM + height_um / 4 * waves, contrast)


def band(seed: int, shape: Shape = (320, 320), contrast: float = 0.4) -> TruthScene:
    """A level plane with a band across it, a fifth of the frame wide, on which there is nothing to see."""
    down, right = _points(shape)
    bare = np.abs(turned(down, right, 12)[0]) < shape[0] * PIXEL_UM / 10
    return smooth_scene("band", seed, shape, np.full_like(down, _MIDDLE_UM), contrast, ~bare)


def stair(seed: int, shape: Shape = (320, 320), treads: int = 6, riser_um: float = 40.0) -> TruthScene:
    """The paper's kind of simulated scene: treads across the frame, each higher than the one before, all textured."""
    _, right = _points(shape)
    tread_um = shape[1] * PIXEL_UM / treads
    first_um = _MIDDLE_UM - (treads - 1) / 2 * riser_um
    heights = [np.full_like(right, first_um + riser_um * n) for n in range(treads)]
    outlines = [(n - treads / 2) * tread_um - right for n in range(1, treads)]
    grey = _grey(0.4, 0.35, np.ones(right.shape, bool), np.random.default_rng(seed))
    return _layered("stair", shape, heights, outlines, [grey] * treads, np.ones(right.shape, bool))


def step(
    seed: int, shape: Shape = (320, 320), step_um: float = 60.3, angle_deg: float = 0.0, lower_um: float | None = None
) -> TruthScene:
    """Two level textured faces, the right one higher; a dark chamfer 8 um wide along the edge of both.

    With BLOCKS_STEP_UM it is the paper's pair of gauge blocks, for STEP_SWEEP_UM.
    """
    down, right = _points(shape)
    away = -turned(down, right, angle_deg)[1]
    sweep_um = STEP_SWEEP_UM if step_um > 300 else SWEEP_UM
    low = float(sweep_um[-1] - step_um) / 2 if lower_um is None else lower_um
    heights = [np.full_like(away, low), np.full_like(away, low + step_um)]
    textured = np.abs(away) > 8.0
    grey = np.where(textured, _grey(0.4, 0.35, textured, np.random.default_rng(seed)), 0.02)
    return _layered("step", shape, heights, [away], [grey, grey], textured)


def dies(
    seed: int,
    shape: Shape = (320, 320),
    *,
    pitch_px: float = 280.0,
    trench_px: float = 56.0,
    corner_fraction: float = 0.02,
    angle_deg: float = 0.0,
    die_grey: float = 0.10,
    trench_grey: float = 0.85,
    die_contrast: float = 0.14,
    trench_contrast: float = 0.20,
    glossy: bool = True,
    bare_share: float = 0.14,
    roll_um: float = 0.0,
    roll_px: float = 14.0,
    rim_gain: float = 0.0,
) -> TruthScene:
    """Weakly textured dies, each 40 to 100 um above a bright trench.

    corner_fraction: radius of the dies' corners over half their width (1: round dies). roll_um: how far the rim is
    rolled off over its last roll_px. rim_gain: how much brighter a polished rim shines in the mirror direction.
    """
    rng = np.random.default_rng(seed)
    down, right = _points(shape)
    phase = rng.uniform(-0.5, 0.5, 2) * pitch_px * PIXEL_UM
    y, x, number = grid_cells(*_moved(turned(down, right, angle_deg), phase), pitch_px * PIXEL_UM)
    half_um = (pitch_px - trench_px) / 2 * PIXEL_UM
    outline = rounded_square(y, x, half_um, corner_fraction * half_um)
    trench_um = float(rng.uniform(110, 130)) + 2 * blobs(down.shape, 60, rng)
    rise_um = rng.uniform(40, 100, number.max() + 1)[number]
    top_um = 120 + rise_um - roll_um * np.clip(1 + outline / (roll_px * PIXEL_UM), 0, 1) ** 2
    textured = ~patches(down.shape, bare_share, 14, rng)
    greys = [
        _grey(trench_grey, trench_contrast, textured, rng),
        _grey(die_grey, die_contrast, textured, rng),
    ]
    scene = _layered("dies", shape, [trench_um, top_um], [outline], greys, textured)
    if glossy:
        _polish(scene, 0, 0.8, rng)
    if rim_gain:
        _polish_rim(scene, rim_gain, roll_px)
    return scene


def rim(seed: int, shape: Shape = (320, 320), **changes: float) -> TruthScene:
    """Dies whose rim is rolled off and polished: it shows a bright line, the lamp's image below the surface."""
    return dies(seed, shape, **{"roll_um": 7.0, "rim_gain": 25.0, **changes})


SCENES: dict[str, Callable[..., TruthScene]] = {
    "band": band,
    "cone": cone,
    "cosine": cosine,
    "dies": dies,
    "plane": plane,
    "rim": rim,
    "stair": stair,
    "step": step,
}


def _points(shape: Shape) -> tuple[Array, Array]:
    return lattice_um(shape, MARGIN_PX, PIXEL_UM)


def _moved(points: tuple[Array, Array], by_um: Array) -> tuple[Array, Array]:
    return points[0] + by_um[0], points[1] + by_um[1]


def _grey(level: float, contrast: float, textured: NDArray[np.bool_], rng: np.random.Generator) -> Array:
    """Reflectance: grain whose contrast varies from place to place, a fiftieth of it where a surface is bare."""
    strength = np.exp(0.5 * blobs(textured.shape, 25, rng)) * np.where(textured, 1.0, 0.02)
    return level * np.clip(1 + contrast * strength * texture(textured.shape, rng), 0.05, 2.5)


def smooth_scene(
    name: str, seed: int, shape: Shape, height_um: Array, contrast: float, textured: NDArray[np.bool_] | None = None
) -> TruthScene:
    """One surface without walls, heights in um on the lattice with its margin; textured: bool on it."""
    textured = np.ones(height_um.shape, bool) if textured is None else textured
    grey = _grey(0.4, contrast, textured, np.random.default_rng(seed))
    return _layered(name, shape, [height_um], [], [grey], textured)


def _layered(
    name: str,
    shape: Shape,
    heights: list[Array],
    outlines: list[Array],
    greys: list[Array],
    textured: NDArray[np.bool_],
) -> TruthScene:
    everywhere = np.full_like(heights[0], -1e6)
    height, outline, grey = (np.stack(a).astype(np.float32) for a in (heights, [everywhere, *outlines], greys))
    nothing = (np.zeros_like(height) for _ in range(3))
    seen = textured[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX]
    return TruthScene(name, height, outline, grey, *nothing, seen, MARGIN_PX)


def _polish(scene: TruthScene, layer: int, gloss: float, rng: np.random.Generator) -> None:
    """Make a layer of a new scene specular, its facets leaning a few degrees each way."""
    scene.gloss[layer] = gloss
    for lean in (scene.lean_rows, scene.lean_cols):
        lean[layer] = 0.09 * texture(scene.height_um.shape[1:], rng)


def _polish_rim(scene: TruthScene, gain: float, roll_px: float) -> None:
    """Let the rim of the top layer mirror a light from straight above: it leaves at twice the slope."""
    at_rim = (scene.outline_um[1] < 0) & (scene.outline_um[1] > -roll_px * scene.pixel_um)
    scene.gloss[1][at_rim] = 0.98
    scene.reflectance[1][at_rim] *= gain
    by_row, by_col = np.gradient(scene.height_um[1], scene.pixel_um)
    scene.lean_rows[1], scene.lean_cols[1] = -2 * by_row, -2 * by_col
