"""Dies beside a bright trench whose light bleeds over them, drawn by seed: two layers, each blurred by its own defocus.

A frame is the sum of the layers, each convolved with the disc of its defocus and with diffraction, by FFT. No wall
hides anything here, unlike in `views`: it is the renderer of another origin, and fast enough to draw many scenes.
Seeds below 1000 are for tuning.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft2, rfft2
from scipy.ndimage import gaussian_filter
from scipy.special import j1

from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.acquisition.plan import Field

WAVELENGTH_UM = 0.55
PIXEL_UM = 0.46729
_MARGIN_PX = 96
_WHITE = 255


@dataclass(frozen=True)
class Bleeding:
    """Optics and sample of a scene: lengths in um and px, ratio of the trench's light to the dies'.

    step_dof: distance of frames in depths of field; trench_grain_px: sigma of the trench's texture; bare_share: of the
    dies, where a sixth of their contrast is left; sweep_um: what the sweep covers beyond the sample; clipped: how much
    of the trench exceeds white where it is in focus: 0 hardly any, 0.1 its brighter grains, 0.9 most of it.
    """

    na: float
    step_dof: float
    trench_px: float
    pitch_px: float
    depth_um: float
    ratio: float
    die_contrast: float
    trench_contrast: float
    trench_grain_px: float
    bare_share: float
    sweep_um: float
    clipped: float
    full_well_e: float
    lines: bool
    seed: int

    @property
    def depth_of_field_um(self) -> float:
        """lambda / NA^2."""
        return WAVELENGTH_UM / self.na**2

    @property
    def step_um(self) -> float:
        """Distance of neighbouring frames."""
        return self.step_dof * self.depth_of_field_um


@dataclass(frozen=True, eq=False)
class Seen:
    """The stack of a scene and its true heights, float32 [row, col]."""

    scene: Bleeding
    stack: FieldStack
    truth_um: NDArray[np.float32]

    def false_share(self, z_um: NDArray[np.float32]) -> float:
        """The share of the measured heights that are more than a step off."""
        stored = np.isfinite(z_um)
        off = np.abs(z_um - self.truth_um) > self.scene.step_um
        return float((off & stored).sum() / max(1, stored.sum()))


def drawn(seed: int) -> Bleeding:
    """The scene of a seed."""
    rng = np.random.default_rng(seed)
    trench_px = float(np.exp(rng.uniform(np.log(16), np.log(90))))
    return Bleeding(
        na=float(rng.uniform(0.20, 0.42)),
        step_dof=float(rng.uniform(0.35, 0.75)),
        trench_px=trench_px,
        pitch_px=trench_px + float(rng.uniform(90, 200)),
        depth_um=float(rng.uniform(25, 80)),
        ratio=float(np.exp(rng.uniform(np.log(2.5), np.log(16)))),
        die_contrast=float(rng.uniform(0.04, 0.14)),
        trench_contrast=float(rng.uniform(0.2, 0.6)),
        trench_grain_px=float(rng.uniform(0.8, 4.0)),
        bare_share=float(rng.uniform(0.0, 0.4)),
        sweep_um=float(rng.uniform(80, 250)),
        clipped=float(rng.choice([0.0, 0.1, 0.9])),
        full_well_e=float(rng.uniform(6e3, 2e4)),
        lines=bool(rng.random() < 0.5),
        seed=seed,
    )


def seen(scene: Bleeding, shape: tuple[int, int] = (256, 256)) -> Seen:
    """The focus stack of a scene, 8 bits."""
    rng = np.random.default_rng((scene.seed, 1))
    z_um = np.arange(0.0, scene.depth_um + scene.sweep_um, scene.step_um)
    images = np.empty((len(z_um), *shape), np.uint8)
    layers = BlurredLayers(scene, shape, rng)
    for k, z in enumerate(z_um):
        share = layers.light_at(z)
        noisy = share + np.sqrt(share / scene.full_well_e + (0.4 / _WHITE) ** 2) * rng.standard_normal(shape)
        images[k] = np.clip(np.rint(noisy * _WHITE), 0, _WHITE)
    field = Field(number=1, row=0, col=0, x_um=0.0, y_um=0.0, z_start_um=0.0)
    return Seen(scene, FieldStack(field, images, z_um, np.ones(len(z_um), bool), PIXEL_UM), layers.truth_um)


class BlurredLayers:
    """The dies and the trench of a scene, their true heights, and their light on the camera at any focus."""

    def __init__(self, scene: Bleeding, shape: tuple[int, int], rng: np.random.Generator):
        padded = tuple(n + 2 * _MARGIN_PX for n in shape)
        die = _dies(scene, padded, rng)
        low_um = scene.sweep_um / 2
        high_um = low_um + scene.depth_um
        bare = gaussian_filter(rng.standard_normal(padded), 12)
        bare = bare < np.quantile(bare, scene.bare_share)
        texture = _grain(padded, 0.8, rng) * scene.die_contrast * np.where(bare, 1 / 6, 1.0)
        shine = _grain(padded, scene.trench_grain_px, rng) * scene.trench_contrast
        self._layers = [
            (rfft2(die * np.clip(1 + texture, 0.05, None)), high_um),
            (rfft2(scene.ratio * (1 - die) * np.clip(1 + shine, 0.05, None)), low_um),
        ]
        self._scene, self._padded, self._inner = scene, padded, slice(_MARGIN_PX, -_MARGIN_PX)
        on_die = die[self._inner, self._inner] > 0.5
        self.truth_um = np.where(on_die, high_um, low_um).astype(np.float32)

    def light_at(self, z_um: float) -> NDArray[np.float64]:
        """The light with the focus at a height, as a share of white, [row, col]."""
        na, inner = self._scene.na, self._inner
        spread = sum(layer * _transfer(self._padded, na, z_um - at_um) for layer, at_um in self._layers)
        return np.clip(irfft2(spread, self._padded)[inner, inner] / _white(self._scene), 0, None)


def _dies(scene: Bleeding, shape: tuple[int, ...], rng: np.random.Generator) -> NDArray[np.float64]:
    """1 on dies, 0 in trenches: crossing ones or parallel ones, anyhow placed."""
    cross = [np.abs((np.arange(n) + rng.uniform(0, scene.pitch_px)) % scene.pitch_px) < scene.trench_px for n in shape]
    trench = cross[1][None, :] & np.ones(shape, bool) if scene.lines else cross[0][:, None] | cross[1][None, :]
    return 1.0 - trench


def _grain(shape: tuple[int, ...], sigma_px: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Noise of one grain size, of mean 0 and deviation 1."""
    grain = gaussian_filter(rng.standard_normal(shape), sigma_px)
    return grain / grain.std()


def _white(scene: Bleeding) -> float:
    """The light that is white: the trench's brighter grains are clipped, more of them the lower it is."""
    return scene.ratio * (1.6 if scene.clipped == 0 else 1.25 if scene.clipped < 0.5 else 0.75)


def _transfer(shape: tuple[int, ...], na: float, defocus_um: float) -> NDArray[np.float64]:
    """What is left of each frequency: the disc of a defocus, diffraction, and the area of a pixel."""
    frequency, place, rows, cols = _frequencies(shape)
    radius_um = abs(defocus_um) * na / np.sqrt(1 - na**2)
    x = 2 * np.pi * radius_um * frequency
    disc = np.where(x > 1e-6, 2 * j1(np.maximum(x, 1e-6)) / np.maximum(x, 1e-6), 1.0)
    sigma_um = 0.21 * WAVELENGTH_UM / na
    return (disc * np.exp(-2 * (np.pi * sigma_um * frequency) ** 2))[place] * np.sinc(rows) * np.sinc(cols)


@cache
def _frequencies(shape: tuple[int, ...]) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """The different frequencies in 1/um, which of them each place of a transform has, and those of rows and cols."""
    rows, cols = np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])[None, :]
    frequency, place = np.unique(np.hypot(rows, cols) / PIXEL_UM, return_inverse=True)
    return frequency, place.reshape(shape[0], -1), rows, cols
