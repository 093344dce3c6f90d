"""Focus stacks of many families of samples, drawn by seed, by four renderers of different origin.

| family | sample | renderer |
|---|---|---|
| trenches | dies beside trenches, polished rims, steps, smooth relief (`unseen`) | layers by FFT, rays past walls |
| print | smooth relief that wears polygons, text or pads with hard edges, hardly any texture, in noise | gather |
| textbook | cone, sphere or stairs with stones, the dark ones bare, in noise, as in simulations of the field | gather |
| bumps | smooth bumps (`relief`) by rays; balls of solder on their ground by waves | rays; gather |
| metal | rough ground whose highlights saturate | gather, waves |
| boards | circuit boards with parts, ten photographs | layers, one over the other |
| bare | ground without texture, and overexposed ground, on relief and stairs | gather |
| holes | ground without texture in textured surroundings: squares, rings, patches, in light that fades | gather |
| particles | small particles and narrow ridges on flat ground | gather, layers |

Only trenches, boards, particles, stairs and some steps have walls. The gathering renderer reads each pixel from the
picture that is blurred by its own distance from the focus; the layers of a board hide what lies below them. Lenses blur
by a Gaussian or a disc, at a rate that only the scene knows, or by waves. Seeds below 1000 are for tuning, and figures
are reported on seeds from 1000 on.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from scipy.fft import irfft2, rfft2
from scipy.spatial import cKDTree
from scipy.special import j1

from tests.truth.phase import Transfer
from tests.truth.relief import drawn_relief
from tests.truth.shapes import blobs, patches
from tests.truth.unseen import drawn_scene, light_at_heights, log_uniform
from tests.truth.views import Camera
from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.acquisition.plan import Field

Rng = np.random.Generator
Array = NDArray[np.floating]
WAVELENGTH_UM = 0.55
SHARPEST_PX = 0.45
"""Standard deviation of the blur in focus of a lens that blurs by a Gaussian or a disc."""
WIDENING = 0.04
"""Relative distance of neighbouring blurred pictures far from focus."""


@dataclass(frozen=True, eq=False)
class FamilyScene:
    """A drawn scene: its stack, true heights in um and grey in focus, float32 [row, col], and its depth of field.

    Without waves, the depth of field is the distance over which the blur grows by one pixel.
    """

    about: str
    stack: FieldStack
    truth_um: NDArray[np.float32]
    sharp_grey: NDArray[np.float32]
    depth_of_field_um: float

    @property
    def step_um(self) -> float:
        """Distance of neighbouring frames: a height further off is false."""
        return float(np.median(np.diff(self.stack.z_um)))

    @property
    def right_um(self) -> float:
        """A height is right within a step, or half a depth of field if that is more."""
        return max(self.step_um, self.depth_of_field_um / 2)


def family_scene(family: str, seed: int) -> FamilyScene:
    """The scene of a family and a seed."""
    return FAMILIES[family](seed)


# --------------------------------------------------------------------------------------------------------------- lenses


@dataclass(frozen=True)
class Lens:
    """A lens that blurs by a standard deviation of blur_px per um, or by the waves of an aperture."""

    kind: Literal["gauss", "disc", "waves"]
    pixel_um: float
    blur_px: float = 0.0
    na: float = 0.0

    @property
    def depth_of_field_um(self) -> float:
        return WAVELENGTH_UM / self.na**2 if self.kind == "waves" else 1 / self.blur_px

    def transfer(self, shape: tuple[int, int]) -> Callable[[float], Array]:
        """The transfer of a distance from the focus, for transforms of pictures."""
        if self.kind == "waves":
            return Transfer(shape, self.na, self.pixel_um).at
        frequency = np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])[None, :])
        focused = np.exp(-2 * (np.pi * SHARPEST_PX * frequency) ** 2)

        def at(off_um: float) -> Array:
            sigma_px = self.blur_px * abs(off_um)
            if self.kind == "gauss":
                return focused * np.exp(-2 * (np.pi * sigma_px * frequency) ** 2)
            x = np.maximum(4 * np.pi * sigma_px * frequency, 1e-9)
            return focused * 2 * j1(x) / x

        return at


def unknown_lens(rng: Rng, blur_px_a_step: float) -> tuple[Lens, float]:
    """A lens of rays whose pixel fits its aperture, and the step in um that blurs by so much."""
    pixel_um = log_uniform(rng, 0.3, 2.0)
    tangent = log_uniform(rng, max(0.05, 0.09 / pixel_um), 0.5)
    lens = Lens("gauss" if rng.random() < 0.5 else "disc", pixel_um, tangent / (2 * pixel_um))
    return lens, blur_px_a_step / lens.blur_px


def wave_lens(rng: Rng, least_na: float = 0.14) -> tuple[Lens, float]:
    """An objective, and a step of .2 to .9 depths of field."""
    lens = Lens("waves", 0.46729, na=log_uniform(rng, least_na, 0.45))
    return lens, float(rng.uniform(0.2, 0.9)) * lens.depth_of_field_um


def gathered(sharp: Array, height_um: Array, z_um: Array, lens: Lens) -> NDArray[np.float32]:
    """Light [k, row, col] of a picture on a relief: each pixel blurred by its own distance from the focus."""
    spectrum, transfer = rfft2(sharp), lens.transfer(sharp.shape)
    farthest = max(float(z_um[-1] - height_um.min()), float(height_um.max() - z_um[0]))
    unit_um = 0.06 * lens.depth_of_field_um
    n_levels = int(np.ceil(np.log1p(WIDENING * farthest / unit_um) / WIDENING)) + 2
    levels_um = unit_um * np.expm1(WIDENING * np.arange(n_levels)) / WIDENING
    blurred = np.stack([irfft2(spectrum * transfer(d), sharp.shape) for d in levels_um]).astype(np.float32)
    light = np.empty((len(z_um), *sharp.shape), np.float32)
    for k, z in enumerate(z_um):
        place = np.interp(np.abs(z - height_um), levels_um, np.arange(n_levels))
        whole = np.minimum(place.astype(np.intp), n_levels - 2)
        near, far = (np.take_along_axis(blurred, n[None], axis=0)[0] for n in (whole, whole + 1))
        light[k] = near + (place - whole) * (far - near)
    return light


class Layer(NamedTuple):
    """A level part of a board: its light, where it covers what lies below, and its height."""

    light: Array
    covers: Array
    height_um: float


def layered(layers: list[Layer], z_um: Array, lens: Lens) -> NDArray[np.float32]:
    """Light [k, row, col] of layers from the lowest to the highest, each blurred and laid over those below."""
    shape = layers[0].light.shape
    transfer = lens.transfer(shape)
    spectra = [(rfft2(layer.light * layer.covers), rfft2(layer.covers), layer.height_um) for layer in layers]
    light = np.zeros((len(z_um), *shape), np.float32)
    for k, z in enumerate(z_um):
        for own, covers, height_um in spectra:
            passes = transfer(z - height_um)
            light[k] = irfft2(own * passes, shape) + (1 - irfft2(covers * passes, shape)) * light[k]
    return light


# ---------------------------------------------------------------------------------------------------- stacks and shapes


def swept(low_um: float, high_um: float, step_um: float, rng: Rng, frames: tuple[int, int]) -> Array:
    """The z of the frames about a sample between two heights, two depths of field and a little more beyond it."""
    n = int(np.clip(np.ceil((high_um - low_um) / step_um + rng.uniform(10, 20)), *frames))
    return (low_um + high_um) / 2 + step_um * (np.arange(n) - (n - 1) / 2 + rng.uniform(-0.5, 0.5))


def shot(
    about: str,
    seed: int,
    light: NDArray[np.float32],
    height_um: Array,
    z_um: Array,
    lens: Lens,
    camera: Camera,
    known: bool = False,
) -> FamilyScene:
    """The scene that a camera takes of light, given as a share of white; known: the depth of field is told."""
    images = camera.shoot(light.clip(0, None), 1.0, seed)
    field = Field(number=1, row=0, col=0, x_um=0.0, y_um=0.0, z_start_um=float(z_um[0]))
    present = np.ones(len(z_um), bool)
    depth_um = lens.depth_of_field_um
    told_um = depth_um if known else 0.0
    stack = FieldStack(field, images, z_um, present, lens.pixel_um, simulated=True, depth_of_field_um=told_um)
    step_um = float(z_um[1] - z_um[0])
    about = f"{about}, {lens.kind}, {len(z_um)} frames of {step_um / depth_um:.2f} depths of field"
    truth_um = height_um.astype(np.float32)
    sharp_grey = 255 * light_at_heights(light, z_um, truth_um).clip(0, 1)
    return FamilyScene(about, stack, truth_um, sharp_grey, depth_um)


def noisy(rng: Rng, low: float, high: float) -> Camera:
    """A camera whose noise is so many counts of 255."""
    return Camera(None, float(rng.uniform(low, high)))


def place(shape: tuple[int, int]) -> tuple[Array, Array]:
    """Rows and columns from the middle of a frame, in halves of its sides."""
    return np.meshgrid(*(np.linspace(-1, 1, n) for n in shape), indexing="ij")


def smooth(name: str, shape: tuple[int, int], rng: Rng) -> Array:
    """A smooth shape from 0 to 1."""
    y, x = place(shape)
    y0, x0 = rng.uniform(-0.3, 0.3, 2)
    match name:
        case "cone":
            height = -np.hypot(y - y0, x - x0)
        case "sphere":
            height = np.sqrt(np.clip(2.2 - (y - y0) ** 2 - (x - x0) ** 2, 0, None))
        case "waves":
            turn = rng.uniform(0, np.pi)
            height = np.cos(rng.uniform(2, 7) * (np.cos(turn) * x + np.sin(turn) * y) + rng.uniform(0, 6))
        case "stairs":
            turn = rng.uniform(0, np.pi)
            height = np.floor(rng.uniform(2, 4) * (np.cos(turn) * x + np.sin(turn) * y + 2))
        case _:
            height = rng.uniform(-1, 1) * x + rng.uniform(-1, 1) * y
    height = height - height.min()
    return height / height.max()


def cells(shape: tuple[int, int], count: int, rng: Rng) -> NDArray[np.intp]:
    """The Voronoi cell of each pixel."""
    points = rng.uniform(0, 1, (count, 2)) * shape
    pixels = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1).reshape(-1, 2)
    return cKDTree(points).query(pixels)[1].reshape(shape)


def polygons(shape: tuple[int, int], rng: Rng) -> Array:
    """Flat polygons in grey levels of 30 to 210."""
    count = int(log_uniform(rng, 60, 600) * shape[0] * shape[1] / 256**2)
    return rng.uniform(30, 210, count)[cells(shape, count, rng)]


def lettering(shape: tuple[int, int], rng: Rng) -> Array:
    """Text, pads and lines in grey levels of 30 to 210 on a ground of another grey."""
    greys = rng.permutation(np.linspace(30, 210, 6)).astype(int).tolist()
    image = Image.new("L", shape[::-1], greys[0])
    draw = ImageDraw.Draw(image)
    for _ in range(int(log_uniform(rng, 60, 160) * shape[0] * shape[1] / 256**2)):
        grey = greys[int(rng.integers(1, 6))]
        x, y, size = rng.uniform(-10, shape[1]), rng.uniform(-10, shape[0]), log_uniform(rng, 5, 24)
        kind = rng.integers(4)
        if kind == 0:
            letters = "".join(rng.choice(list("ABCDEHKLMNRSTXZ0123456789"), 5))
            draw.text((x, y), letters, fill=grey, font=ImageFont.load_default(size))
        elif kind == 1:
            draw.rectangle((x, y, x + size, y + size * rng.uniform(0.5, 2)), fill=grey)
        elif kind == 2:
            draw.ellipse((x, y, x + size, y + size), fill=grey)
        else:
            end = (x + 60, y) if rng.random() < 0.5 else (x, y + 60)
            draw.line((x, y, *end), fill=grey, width=int(rng.integers(2, 6)))
    return np.asarray(image, float)


def grain(shape: tuple[int, int], rng: Rng) -> Array:
    """Fine texture of deviation 1."""
    return blobs(shape, float(rng.uniform(0.6, 1.2)), rng).astype(float)


# ------------------------------------------------------------------------------------------------------------- families


def trenches(seed: int) -> FamilyScene:
    scene = drawn_scene(seed)
    return FamilyScene(scene.about, scene.stack, scene.truth_um, scene.sharp_grey, scene.instrument.depth_of_field_um)


def printed(seed: int) -> FamilyScene:
    rng = np.random.default_rng((seed, 51))
    shape = (side := int(rng.choice([256, 320, 384])), side)
    lens, step_um = unknown_lens(rng, float(rng.uniform(0.1, 0.35)))
    name = str(rng.choice(["cone", "sphere", "waves", "plane"]))
    pattern = polygons if rng.random() < 0.6 else lettering
    grey = pattern(shape, rng) + rng.uniform(0, 2) * grain(shape, rng)
    n = int(rng.integers(24, 61))
    z_um = step_um * np.arange(n)
    height_um = step_um * (n - 1) * (0.5 + rng.uniform(0.3, 0.6) * (smooth(name, shape, rng) - 0.5))
    light = gathered(grey / 255, height_um, z_um, lens)
    return shot(f"{pattern.__name__} on a {name}", seed, light, height_um, z_um, lens, noisy(rng, 3, 5))


def textbook(seed: int) -> FamilyScene:
    rng = np.random.default_rng((seed, 52))
    shape, n = (256, 256), 30
    lens, step_um = unknown_lens(rng, log_uniform(rng, 0.1, 0.5))
    name = str(rng.choice(["cone", "cone", "sphere", "stairs"]))
    count = int(log_uniform(rng, 40, 400))
    of = cells(shape, count, rng)
    dark = rng.random(count) < rng.uniform(0.2, 0.45)
    grey = np.where(dark, rng.uniform(-8, 20, count), rng.uniform(70, 170, count))[of]
    counts = np.where(dark, 0.0, np.exp(rng.uniform(np.log(2), np.log(25), count)))
    grains = np.stack([blobs(shape, sigma_px, rng) for sigma_px in (0.6, 1.2, 2.5, 5.0)])
    which = rng.integers(len(grains), size=count)
    grey += counts[of] * np.take_along_axis(grains, which[of][None], axis=0)[0]
    z_um = step_um * np.arange(n)
    height_um = step_um * (n - 1) * (0.5 + rng.uniform(0.5, 0.75) * (smooth(name, shape, rng) - 0.5))
    light = gathered(grey / 255, height_um, z_um, lens)
    return shot(f"stones on {name}", seed, light, height_um, z_um, lens, noisy(rng, 3.5, 5))


def bumps(seed: int) -> FamilyScene:
    if seed % 2 == 0:
        relief = drawn_relief(seed, 160, "bumps")
        truth_um = relief.truth_um.astype(np.float32)
        return FamilyScene(f"bumps, {relief.about}", relief.stack, truth_um, relief.sharp_grey, relief.depth_um)
    rng = np.random.default_rng((seed, 53))
    shape = (256, 256)
    lens, step_um = wave_lens(rng, 0.25)
    row, col = np.mgrid[: shape[0], : shape[1]]
    pitch_px, wide = float(rng.uniform(50, 100)), float(rng.uniform(0.5, 0.9))
    from_row, from_col = ((one + rng.uniform(0, pitch_px)) % pitch_px - pitch_px / 2 for one in (row, col))
    radius_px = wide * pitch_px / 2
    cap = np.sqrt(np.clip(radius_px**2 - from_row**2 - from_col**2, 0, None)) - radius_px * rng.uniform(0, 0.6)
    most_um = 110 * step_um
    height_um = np.clip(cap, 0, None) * lens.pixel_um
    height_um *= min(1.0, most_um / height_um.max())
    on_ball = height_um > 0
    grey = np.where(on_ball, rng.uniform(60, 150), rng.uniform(40, 180))
    grey = grey * (1 + rng.uniform(0.04, 0.3) * grain(shape, rng))
    z_um = swept(0.0, float(height_um.max()), step_um, rng, (25, 150))
    light = gathered(grey / 255, height_um, z_um, lens)
    camera = Camera(log_uniform(rng, 4e3, 4e4), float(rng.uniform(0.2, 1.0)))
    return shot("balls", seed, light, height_um, z_um, lens, camera, known=rng.random() < 0.5)


def metal(seed: int) -> FamilyScene:
    rng = np.random.default_rng((seed, 54))
    shape = (256, 256)
    lens, step_um = wave_lens(rng, 0.25)
    fine_px = log_uniform(rng, 2, 8)
    rough = (blobs(shape, 5 * fine_px, rng) + rng.uniform(0.05, 0.2) * blobs(shape, fine_px, rng)).astype(float)
    steep = float(np.quantile(np.hypot(*np.gradient(rough, lens.pixel_um)), 0.99))
    height_um = rough * min(log_uniform(rng, 0.3, 1.0) / steep, 110 * step_um / float(np.ptp(rough)))
    down, right = np.gradient(height_um + 0.15 * lens.pixel_um * blobs(shape, 1.0, rng), lens.pixel_um)
    tilt, narrow = rng.uniform(0, 0.1, 2), rng.uniform(0.05, 0.2)
    facets = np.exp(-((down - tilt[0]) ** 2 + (right - tilt[1]) ** 2) / (2 * narrow**2))
    grey = rng.uniform(0.08, 0.3) * (1 + 0.1 * grain(shape, rng)) + log_uniform(rng, 0.5, 4.0) * facets
    z_um = swept(float(height_um.min()), float(height_um.max()), step_um, rng, (25, 150))
    light = gathered(grey, height_um, z_um, lens)
    camera = Camera(log_uniform(rng, 4e3, 4e4), float(rng.uniform(0.2, 1.0)))
    saturated = np.mean(grey > 1)
    about = f"rough metal, {100 * saturated:.0f} % saturated"
    return shot(about, seed, light, height_um, z_um, lens, camera, known=rng.random() < 0.5)


def boards(seed: int) -> FamilyScene:
    rng = np.random.default_rng((seed, 55))
    shape, n = (320, 384), int(rng.integers(9, 13))
    lens, step_um = unknown_lens(rng, float(rng.uniform(0.4, 0.9)))
    grain_counts = rng.uniform(1, 4)
    ground_um = step_um * rng.uniform(1.5, 2.5)
    grounded = lettering(shape, rng) + grain_counts * grain(shape, rng)
    layers = [Layer(grounded / 255, np.ones(shape), ground_um)]
    height_um = np.full(shape, ground_um)
    row, col = np.mgrid[: shape[0], : shape[1]]
    for top in np.sort(rng.uniform(1, n - 4, int(rng.integers(6, 14)))):
        middle, half = rng.uniform(0, shape), rng.uniform(12, 45, 2)
        away = np.abs(row - middle[0]) / half[0], np.abs(col - middle[1]) / half[1]
        covers = np.hypot(*away) < 1 if rng.random() < 0.3 else np.maximum(*away) < 1
        body = rng.uniform(15, 220) + 0.4 * (lettering(shape, rng) - 120) + grain_counts * grain(shape, rng)
        layers.append(Layer(body.clip(2, 250) / 255, covers.astype(float), ground_um + top * step_um))
        height_um[covers] = ground_um + top * step_um
    z_um = step_um * np.arange(n)
    light = layered(layers, z_um, lens)
    return shot(f"board, {len(layers) - 1} parts", seed, light, height_um, z_um, lens, noisy(rng, 0.5, 2))


def bare(seed: int) -> FamilyScene:
    rng = np.random.default_rng((seed, 56))
    shape = (256, 256)
    lens, step_um = wave_lens(rng) if seed % 2 else unknown_lens(rng, float(rng.uniform(0.15, 0.6)))
    name = str(rng.choice(["plane", "waves", "stairs", "sphere"]))
    height_um = smooth(name, shape, rng) * step_um * rng.uniform(5, 60)
    textured = ~patches(shape, float(rng.uniform(0.2, 0.7)), log_uniform(rng, 6, 40), rng)
    over = patches(shape, float(rng.uniform(0.0, 0.3)), log_uniform(rng, 4, 25), rng)
    contrast = rng.uniform(0.05, 0.3) * textured
    grey = np.where(over, rng.uniform(1.0, 2.0), rng.uniform(0.2, 0.6)) * (1 + contrast * grain(shape, rng))
    z_um = swept(0.0, float(height_um.max()), step_um, rng, (20, 120))
    light = gathered(grey, height_um, z_um, lens)
    camera = Camera(log_uniform(rng, 4e3, 4e4), float(rng.uniform(0.2, 1.5)))
    about = f"bare ground on {name}, {100 * over.mean():.0f} % overexposed"
    return shot(about, seed, light, height_um, z_um, lens, camera, known=bool(seed % 2) and rng.random() < 0.5)


def holes(seed: int) -> FamilyScene:
    """Ground whose texture hardly rises over the noise, or not at all: its surroundings vouch for it wrongly."""
    rng = np.random.default_rng((seed, 57))
    shape = (192, 256)
    lens, step_um = wave_lens(rng) if seed % 2 else unknown_lens(rng, log_uniform(rng, 0.15, 0.8))
    name = str(rng.choice(["plane", "plane", "waves", "sphere", "cone"]))
    height_um = smooth(name, shape, rng) * step_um * rng.uniform(2, 30)
    z_um = swept(0.0, float(height_um.max()), step_um, rng, (20, 80))
    inside = hole(str(rng.choice(["square", "ring", "patches"])), shape, rng)
    faint = 0.0 if rng.random() < 0.5 else log_uniform(rng, 0.002, 0.05)
    contrast = np.where(inside, faint, 1.0) * log_uniform(rng, 0.05, 0.5)
    grey, texture = rng.uniform(0.25, 0.6), grain(shape, rng)
    if rng.random() < 0.5:
        light = gathered(grey * (1 + contrast * texture), height_um, z_um, lens)
    else:
        light = np.float32(grey) * (1 + contrast.astype(np.float32) * gathered(texture, height_um, z_um, lens))
    fades = float(rng.choice([0.0, rng.uniform(-0.3, 0.3)]))
    fading = np.linspace(1 + fades, 1 - fades, len(z_um), dtype=np.float32)[:, None, None]
    camera = noisy(rng, 0.5, 4) if rng.random() < 0.5 else Camera(log_uniform(rng, 4e3, 4e4), rng.uniform(0.2, 1.5))
    about = f"{100 * inside.mean():.0f} % bare on {name}"
    scene = shot(about, seed, light, height_um, z_um, lens, camera, known=bool(seed % 2) and rng.random() < 0.5)
    images = np.rint(scene.stack.images * fading).clip(0, 255).astype(np.uint8)  # a lamp, or a gain, that changes
    return replace(scene, stack=replace(scene.stack, images=images))


def hole(kind: str, shape: tuple[int, int], rng: Rng) -> NDArray[np.bool_]:
    """A mask of squares, of rings, or of irregular patches, of any size."""
    if kind == "patches":
        return patches(shape, float(rng.uniform(0.1, 0.6)), log_uniform(rng, 4, 40), rng)
    row, col = np.mgrid[: shape[0], : shape[1]]
    found = np.zeros(shape, np.bool_)
    for _ in range(int(rng.integers(1, 5))):
        middle, half = rng.uniform(0, 1, 2) * shape, np.array([log_uniform(rng, 6, 60), log_uniform(rng, 6, 60)])
        away = np.abs(row - middle[0]) / half[0], np.abs(col - middle[1]) / half[1]
        if kind == "square":
            found |= np.maximum(*away) < 1
        else:
            found |= np.abs(np.hypot(*away) - 0.75) < 0.25
    return found


def particles(seed: int) -> FamilyScene:
    rng = np.random.default_rng((seed, 58))
    shape = (192, 256)
    lens, step_um = wave_lens(rng, 0.2) if seed % 2 else unknown_lens(rng, log_uniform(rng, 0.15, 0.6))
    row, col = np.mgrid[: shape[0], : shape[1]]
    fine = log_uniform(rng, 0.03, 0.3)
    ground = rng.uniform(0.15, 0.7)
    layers = [Layer(ground * (1 + fine * grain(shape, rng)), np.ones(shape), 0.0)]
    height_um, seen = np.zeros(shape), layers[0].light.copy()
    for rise in np.sort(rng.uniform(4, 30, int(rng.integers(5, 10)))):
        middle, across = rng.uniform(0, 1, 2) * shape, log_uniform(rng, 2, 14)
        along = across * (rng.uniform(3, 12) if rng.random() < 0.3 else rng.uniform(1, 1.5))
        turn = rng.uniform(0, np.pi)
        down, right = row - middle[0], col - middle[1]
        away = np.hypot(
            (np.cos(turn) * down + np.sin(turn) * right) / across, (np.cos(turn) * right - np.sin(turn) * down) / along
        )
        covers = away < 1
        light = (ground * rng.uniform(0.4, 1.6) * (1 + fine * grain(shape, rng))).clip(0.02, 0.98)
        layers.append(Layer(light, covers.astype(float), rise * step_um))
        dome = np.sqrt(np.clip(1 - away**2, 0, None)) if seed % 4 < 2 else np.ones(shape)
        height_um = np.where(covers, rise * step_um * dome, height_um)
        seen = np.where(covers, light, seen)
    z_um = swept(0.0, float(height_um.max()), step_um, rng, (20, 80))
    domes = seed % 4 < 2
    light = gathered(seen, height_um, z_um, lens) if domes else layered(layers, z_um, lens)
    camera = Camera(log_uniform(rng, 4e3, 4e4), float(rng.uniform(0.2, 1.5)))
    about = f"{len(layers) - 1} {'domes' if domes else 'flat parts'}"
    return shot(about, seed, light, height_um, z_um, lens, camera, known=bool(seed % 2) and rng.random() < 0.5)


FAMILIES: dict[str, Callable[[int], FamilyScene]] = {
    "trenches": trenches,
    "print": printed,
    "textbook": textbook,
    "bumps": bumps,
    "metal": metal,
    "boards": boards,
    "bare": bare,
    "holes": holes,
    "particles": particles,
}
