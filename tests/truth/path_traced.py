"""Scenes by a path tracer of other people, Mitsuba 3, drawn by seed: the renderer that shares nothing with ours.

Light bounces between walls and floor, metals are rough mirrors, bumps hide what is beside them, and the lens is a thin
one whose aperture every path crosses somewhere else. Diffraction, exposure and the faults of frames are those of
`unseen`. The noise of the paths, some 2 %, adds to that of the camera and is no shot noise. Sides are slopes of half a
pixel: etched trenches around dies, balls of solder, pits and steps, all textured, some of them metal.

Needs Mitsuba (``pip install mitsuba``), and is some ten times as fast with LLVM 17 or newer (on Debian: libllvm19).
Seeds below 1000 are for tuning.
"""

from __future__ import annotations

import ctypes.util
import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter

from tests.truth.bleeding import PIXEL_UM, WAVELENGTH_UM
from tests.truth.unseen import Instrument, Unseen, drawn_instrument, jittered, log_uniform, shot

LONGEST_SWEEP = 45
"""Frames: a path-traced frame takes a second or two."""
PATHS = 96
"""Paths a pixel."""
BOUNCES = 4
LIGHTS = 12
"""Directions from which light comes through the lens."""
FAR_UM = 1e5
"""Distance of the lens, so far that nothing looks larger for being nearer."""
MARGIN_PX = 100
"""Width of the sample around the frame: light enters from beyond its border."""
STEEP = 1.0
"""Slope from which a side is a wall."""
FINE = 2
"""Vertices a pixel."""
_LLVM = ("LLVM-22", "LLVM-21", "LLVM-20", "LLVM-19", "LLVM-18", "LLVM-17")
Floats = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Solid:
    """A sample on a lattice of `FINE` points a pixel, [row, col]: height in um, reflectance, and what is metal."""

    name: str
    height_um: Floats
    reflectance: Floats
    metal: NDArray[np.bool_]
    roughness: float


def path_traced_scene(seed: int, side: int = 144, paths: int = PATHS) -> Unseen:
    """The scene of a seed; its light is kept in the folder of temporary files."""
    rng = np.random.default_rng((seed, 47))
    instrument = drawn_instrument(rng)
    solid = drawn_solid(side, rng)
    truth_um = _at_pixels(solid.height_um, side)
    z_um = _sweep_um(instrument, float(truth_um.min()), float(truth_um.max()))
    at_um = jittered(z_um, instrument, rng)
    light = _kept(f"{seed}-{side}-{paths}", lambda: light_of(solid, instrument.na, at_um, side, paths, seed))
    light = light / np.float32(np.quantile(light.max(axis=0), 1 - float(rng.choice([0.0005, 0.01, 0.1]))))
    slope = np.hypot(*np.gradient(truth_um, PIXEL_UM))
    walls = slope > STEEP
    distance_px = distance_transform_edt(~walls) if walls.any() else np.full(walls.shape, np.inf)
    return shot(seed, f"paths, {solid.name}", instrument, z_um, light, truth_um, distance_px, rng)


def drawn_solid(side: int, rng: np.random.Generator) -> Solid:
    """A sample of a random kind."""
    kinds = {"dies": _dies, "balls": _balls, "pits": _pits, "step": _step}
    name = str(rng.choice(list(kinds), p=[0.4, 0.25, 0.15, 0.2]))
    n = FINE * (side + 2 * MARGIN_PX)
    down, right = (PIXEL_UM / FINE * (axis - n / 2) for axis in np.mgrid[:n, :n].astype(np.float32))
    height_um, raised = kinds[name](down, right, rng)
    texture, grain = _grain(n, float(rng.uniform(0.7, 1.5)), rng), _grain(n, float(rng.uniform(0.7, 3.0)), rng)
    contrast = log_uniform(rng, 0.06, 0.35), log_uniform(rng, 0.06, 0.35)
    bright = float(rng.uniform(0.1, 0.6)), float(rng.uniform(0.1, 0.8))
    reflectance = np.where(raised, bright[0] * (1 + contrast[0] * texture), bright[1] * (1 + contrast[1] * grain))
    metal = raised if name == "balls" else ~raised if rng.random() < 0.4 else np.zeros_like(raised)
    tilt = rng.uniform(-0.02, 0.02, 2)
    height_um = height_um + tilt[0] * down + tilt[1] * right
    clipped = reflectance.clip(0.01, 0.95).astype(np.float32)
    return Solid(name, height_um.astype(np.float32), clipped, metal, float(rng.uniform(0.15, 0.5)))


def light_of(solid: Solid, na: float, z_um: NDArray[np.float64], side: int, paths: int, seed: int) -> Floats:
    """The light on the camera with the focus at each height, [k, row, col]."""
    mi = _mitsuba()
    scene = mi.load_dict(_described(mi, solid, na, side))
    settings = mi.traverse(scene)
    light = np.empty((len(z_um), side, side), np.float32)
    for k, z in enumerate(z_um):
        settings["sensor.focus_distance"] = FAR_UM - float(z)
        settings.update()
        image = np.asarray(mi.render(scene, spp=paths, seed=1000 * seed + k), np.float32)
        light[k] = gaussian_filter(image.reshape(side, side, -1)[..., 0], 0.21 * WAVELENGTH_UM / na / PIXEL_UM)
    return light


def _dies(down: Floats, right: Floats, rng: np.random.Generator) -> tuple[Floats, NDArray[np.bool_]]:
    """Dies between trenches whose sides lean by up to 20 degrees."""
    trench_um, pitch_um = PIXEL_UM * log_uniform(rng, 10, 80), PIXEL_UM * float(rng.uniform(110, 300))
    depth_um, lean = log_uniform(rng, 8, 50), float(np.tan(np.radians(rng.uniform(1, 20))))
    turned = _turned(down, right, float(rng.choice([0.0, rng.uniform(0, 90)])))
    cross = rng.random() < 0.5
    starts = rng.uniform(0, pitch_um, 2)
    away = [np.abs((axis + start) % pitch_um - pitch_um / 2) for axis, start in zip(turned, starts, strict=True)]
    from_middle_um = np.minimum(*away) if cross else away[0]
    inside_um = from_middle_um - trench_um / 2
    return -depth_um * (1 - (inside_um / (lean * depth_um)).clip(0, 1)), inside_um > 0.5 * lean * depth_um


def _balls(down: Floats, right: Floats, rng: np.random.Generator) -> tuple[Floats, NDArray[np.bool_]]:
    """Caps of balls of solder on a level board."""
    radius_um, pitch_um = float(rng.uniform(10, 28)), float(rng.uniform(62, 90))
    share = float(rng.uniform(0.4, 0.95))
    cells = [(axis + rng.uniform(0, pitch_um)) % pitch_um - pitch_um / 2 for axis in (down, right)]
    square = radius_um**2 - cells[0] ** 2 - cells[1] ** 2
    cap = np.sqrt(square.clip(0)) - (1 - share) * radius_um
    return cap.clip(0), cap > 0


def _pits(down: Floats, right: Floats, rng: np.random.Generator) -> tuple[Floats, NDArray[np.bool_]]:
    """Round pits with smooth sides in a level face."""
    radius_um, pitch_um, depth_um = float(rng.uniform(8, 25)), float(rng.uniform(60, 90)), float(rng.uniform(4, 25))
    cells = [(axis + rng.uniform(0, pitch_um)) % pitch_um - pitch_um / 2 for axis in (down, right)]
    away = np.hypot(*cells) / radius_um
    return -depth_um * (1 + np.cos(np.pi * away.clip(0, 1))) / 2, away > 0.6


def _step(down: Floats, right: Floats, rng: np.random.Generator) -> tuple[Floats, NDArray[np.bool_]]:
    """Two levels with a side that leans by up to 40 degrees."""
    along, _ = _turned(down, right, float(rng.uniform(0, 360)))
    height_um, lean = log_uniform(rng, 5, 60), float(np.tan(np.radians(rng.uniform(1, 40))))
    share = ((along - rng.uniform(-15, 15)) / (lean * height_um)).clip(0, 1)
    return height_um * share, share > 0.5


def _turned(down: Floats, right: Floats, degrees: float) -> tuple[Floats, Floats]:
    c, s = np.float32(np.cos(np.radians(degrees))), np.float32(np.sin(np.radians(degrees)))
    return c * down - s * right, s * down + c * right


def _grain(n: int, sigma_px: float, rng: np.random.Generator) -> Floats:
    grain = gaussian_filter(rng.standard_normal((n, n), np.float32), FINE * sigma_px)
    return grain / grain.std()


def _sweep_um(instrument: Instrument, low_um: float, high_um: float) -> NDArray[np.float64]:
    """The z of the frames, fewer of them than in other scenes: wider apart, up to 0.9 depths of field."""
    z_um = instrument.sweep_um(low_um, high_um)
    middle, step_um = (z_um[0] + z_um[-1]) / 2, float(z_um[1] - z_um[0])
    n = min(len(z_um), LONGEST_SWEEP)
    widest_um = max(step_um, 0.9 * instrument.depth_of_field_um)
    step_um = float(np.clip((high_um - low_um + 30.0) / n, step_um, widest_um))
    return middle + step_um * (np.arange(n) - (n - 1) / 2)


def _at_pixels(fine: Floats, side: int) -> Floats:
    """The value at the centres of the pixels of the frame, from the lattice."""
    inner = fine[FINE * MARGIN_PX : FINE * (MARGIN_PX + side), FINE * MARGIN_PX : FINE * (MARGIN_PX + side)]
    return inner.reshape(side, FINE, side, FINE).mean(axis=(1, 3))


def _mitsuba() -> Any:
    """Mitsuba with its fast variant, or, without a newer LLVM, with the slow one."""
    import mitsuba

    library = next((found for name in _LLVM if (found := ctypes.util.find_library(name))), None)
    if library is not None:
        os.environ.setdefault("DRJIT_LIBLLVM_PATH", library)
    mitsuba.set_variant("scalar_rgb" if library is None else "llvm_ad_mono")
    return mitsuba


def _described(mi: Any, solid: Solid, na: float, side: int) -> dict[str, Any]:
    """The scene as Mitsuba is told it."""
    tangent = na / np.sqrt(1 - na**2)
    spiral = [(2.4 * k, na * np.sqrt((k + 0.5) / LIGHTS)) for k in range(LIGHTS)]
    lights = {
        f"light{k}": {
            "type": "directional",
            "direction": [float(sine * np.sin(turn)), float(sine * np.cos(turn)), -float(np.sqrt(1 - sine**2))],
            "irradiance": 1.0 / LIGHTS,
        }
        for k, (turn, sine) in enumerate(spiral)
    }
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": BOUNCES},
        "sky": {"type": "constant", "radiance": 0.02},
        **lights,
        "sample": {"type": "ply", "filename": str(_mesh(mi, solid)), "face_normals": True, "bsdf": _surface(mi, solid)},
        "sensor": {
            "type": "thinlens",
            "aperture_radius": float(FAR_UM * tangent),
            "focus_distance": FAR_UM,
            "fov": float(2 * np.degrees(np.arctan(side * PIXEL_UM / 2 / FAR_UM))),
            "near_clip": FAR_UM / 2,
            "far_clip": 2 * FAR_UM,
            "to_world": mi.ScalarTransform4f().look_at(origin=[0, 0, FAR_UM], target=[0, 0, 0], up=[0, 1, 0]),
            "film": {
                "type": "hdrfilm", "width": side, "height": side, "rfilter": {"type": "box"},
                "pixel_format": "luminance",
            },
            "sampler": {"type": "independent"},
        },
    }  # fmt: skip


def _surface(mi: Any, solid: Solid) -> dict[str, Any]:
    """Matt where there is no metal, a rough mirror where there is; both with the reflectance of the sample."""

    def picture(values: Floats) -> dict[str, Any]:
        return {"type": "bitmap", "bitmap": mi.Bitmap(np.ascontiguousarray(values[..., None])), "raw": True}

    matt = {"type": "diffuse", "reflectance": picture(solid.reflectance)}
    if not solid.metal.any():
        return {"type": "twosided", "bsdf": matt}
    metal = {
        "type": "roughconductor", "material": "none", "alpha": solid.roughness,
        "specular_reflectance": picture(solid.reflectance),
    }  # fmt: skip
    where = picture(solid.metal.astype(np.float32))
    return {"type": "twosided", "bsdf": {"type": "blendbsdf", "weight": where, "first": matt, "second": metal}}


def _mesh(mi: Any, solid: Solid) -> Path:
    """The heights as a mesh in a file; x to the right, y up, row 0 at the top."""
    n = len(solid.height_um)
    rows, cols = np.mgrid[:n, :n].astype(np.float32)
    places = np.stack([
        (cols + 0.5 - n / 2) * (PIXEL_UM / FINE), (n / 2 - rows - 0.5) * (PIXEL_UM / FINE), solid.height_um
    ], axis=-1)  # fmt: skip
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate([
        np.stack([corner, corner + n, corner + 1], axis=-1), np.stack([corner + 1, corner + n, corner + n + 1], axis=-1)
    ])  # fmt: skip
    mesh = mi.Mesh("sample", n * n, len(faces), has_vertex_texcoords=True)
    parts = mi.traverse(mesh)
    parts["vertex_positions"] = places.astype(np.float32).ravel()
    parts["vertex_texcoords"] = np.stack([(cols + 0.5) / n, (rows + 0.5) / n], axis=-1).ravel()
    parts["faces"] = faces.astype(np.uint32).ravel()
    parts.update()
    path = Path(tempfile.mkdtemp()) / "sample.ply"
    mesh.write_ply(str(path))
    return path


def _kept(name: str, make: Callable[[], Floats]) -> Floats:
    path = Path(tempfile.gettempdir()) / "wafer-viewer-truth" / f"paths-{name}.npy"
    if not path.exists():
        path.parent.mkdir(exist_ok=True)
        light = make()
        part = path.with_suffix(f".{os.getpid()}.npy")
        np.save(part, light)
        part.rename(path)
    return np.load(path)
