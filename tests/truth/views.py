"""A focus stack made of views through the aperture: what a microscope sees of layers that hide each other.

The light field comes first: from each of some two hundred points of the pupil every ray is followed down to the sample,
past walls that hide what is behind them. A frame is the mean of the views, each shifted by how far the frame's plane is
from the rays' common plane, times the tangent of the view's angle. Then follow diffraction, the area of a pixel,
exposure, shot noise, read noise and the digits of the camera. So light of a bright trench falls on a dark die that is
not in focus, a wall takes away a part of the aperture, and a specular surface sends each view something else.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from tests.truth.rays import add_view, trace_view
from tests.truth.scene import TruthScene
from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.acquisition.plan import Field

TILE_PX = 320
TRUNCATE = 3.5
LEAST_BLUR_PX = 0.05
LEAST_SHARE = 1e-4
"""Of the views: a layer that fewer see is not seen."""
_PIXEL_VARIANCE_PX = 1 / 12
_SHIFT_VARIANCE_PX = 1 / 6
"""What bilinear shifts by all fractions of a pixel blur by."""
_GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))


@dataclass(frozen=True, slots=True)
class Optics:
    """The aperture. lobe: width of the mirror lobe of specular surfaces, as a tangent."""

    na: float = 0.28
    apodised: bool = False
    views: int = 200
    wavelength_um: float = 0.55
    lobe: float = 0.15

    def pupil(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """(tangents along rows, tangents along cols, weights) of points spread evenly over the pupil."""
        radius = np.sqrt((np.arange(self.views) + 0.5) / self.views)
        angle = _GOLDEN_ANGLE * np.arange(self.views)
        sine = self.na * radius
        tangent = sine / np.sqrt(1 - sine**2)
        weight = np.exp(-(radius**2) / (2 * 0.55**2)) if self.apodised else np.ones(self.views)
        return tangent * np.sin(angle), tangent * np.cos(angle), weight / weight.sum()

    @property
    def diffraction_um(self) -> float:
        """Sigma of the Gaussian nearest to the Airy disc."""
        return 0.21 * self.wavelength_um / self.na

    def point_px(self, pixel_um: float) -> float:
        """Sigma of diffraction and of the pixel's area, less what the shifts of the views have blurred already."""
        return float(np.sqrt((self.diffraction_um / pixel_um) ** 2 + _PIXEL_VARIANCE_PX - _SHIFT_VARIANCE_PX))

    @property
    def cell_tangent(self) -> float:
        """Sigma of the part of the pupil that one view stands for, as a tangent."""
        return self.na * float(np.sqrt(np.pi / self.views / 12))


@dataclass(frozen=True, slots=True)
class Camera:
    """Exposure, noise and digits. full_well_e None: no shot noise; read_grey: of 255, whatever the bits.

    clipped_share: the share of the frame's pixels that exceed white where they are in focus.
    """

    full_well_e: float | None = 15_000.0
    read_grey: float = 1 / 3
    bits: int = 8
    clipped_share: float = 0.001

    @property
    def white(self) -> int:
        """The highest count."""
        return 2**self.bits - 1

    def shoot(self, light: NDArray[np.float32], white_light: float, seed: int) -> NDArray:
        """Counts of light [k, row, col]; a pixel holds hundreds of electrons, so shot noise is taken as Gaussian."""
        rng = np.random.default_rng(seed)
        counts = np.empty(light.shape, np.uint8 if self.bits <= 8 else np.uint16)
        for k, frame in enumerate(light):
            share = frame / np.float32(white_light)
            variance = np.float32((self.read_grey / 255) ** 2)
            if self.full_well_e is not None:
                variance = variance + share / np.float32(self.full_well_e)
            noisy = share + np.sqrt(variance) * rng.standard_normal(frame.shape, np.float32)
            counts[k] = np.clip(np.rint(noisy * self.white), 0, self.white)
        return counts


def light_of(scene: TruthScene, optics: Optics, z_um: NDArray[np.float64]) -> NDArray[np.float32]:
    """The light on the camera, [k, row, col], in units of a white diffuse sheet; float32."""
    n_rows, n_cols = scene.shape
    light = np.empty((len(z_um), n_rows, n_cols), np.float32)
    side = TILE_PX if len(scene.height_um) <= 2 else TILE_PX // 2
    for top in range(0, n_rows, side):
        for left in range(0, n_cols, side):
            bottom, right = min(n_rows, top + side), min(n_cols, left + side)
            light[:, top:bottom, left:right] = _tile(scene, optics, np.asarray(z_um, float), top, left, bottom, right)
    return light


def white_light_of(scene: TruthScene, light: NDArray[np.float32], z_um: NDArray[np.float64], share: float) -> float:
    """The light that gives white when a share of the pixels is to be brighter in the frame where it is in focus."""
    return float(np.quantile(sharp_of(scene, light, z_um), 1 - share))


def sharp_of(scene: TruthScene, light: NDArray[np.float32], z_um: NDArray[np.float64]) -> NDArray[np.float32]:
    """The light of each pixel in the frame nearest to its height, [row, col]."""
    nearest = np.abs(z_um[:, None, None] - scene.truth_um[None]).argmin(axis=0)
    return np.take_along_axis(light, nearest[None], axis=0)[0]


def stack_of(
    scene: TruthScene, optics: Optics, z_um: NDArray[np.float64], camera: Camera = Camera(), seed: int = 1
) -> FieldStack:
    """The focus stack that a camera takes of a scene at the heights z_um; the same seed gives the same bits."""
    light = light_of(scene, optics, z_um)
    return stack_from(scene, light, z_um, camera, seed)


def stack_from(
    scene: TruthScene, light: NDArray[np.float32], z_um: NDArray[np.float64], camera: Camera = Camera(), seed: int = 1
) -> FieldStack:
    """The focus stack of light that is known already: other noise costs no new rays."""
    counts = camera.shoot(light, white_light_of(scene, light, z_um, camera.clipped_share), seed)
    field = Field(number=1, row=0, col=0, x_um=0.0, y_um=0.0, z_start_um=float(z_um[0]))
    present = np.ones(len(z_um), bool)
    return FieldStack(field, counts, np.asarray(z_um, float), present, scene.pixel_um, simulated=True)


def _tile(
    scene: TruthScene, optics: Optics, z_um: NDArray[np.float64], top: int, left: int, bottom: int, right: int
) -> NDArray[np.float32]:
    cell_px = _cell_px(scene, optics, z_um)
    halo = int(np.ceil(TRUNCATE * (cell_px.max() + optics.point_px(scene.pixel_um)))) + 1
    n_rows, n_cols = bottom - top + 2 * halo, right - left + 2 * halo
    origin = scene.margin_px + top - halo, scene.margin_px + left - halo
    n_layers = len(scene.height_um)
    totals = np.zeros((2 * n_layers - 1, len(z_um), n_rows, n_cols), np.float32)
    plane_um = float(z_um[0] + z_um[-1]) / 2
    tops, bottoms = _extents(scene, plane_um)
    heights = scene.height_um - np.float32(plane_um)
    jitter = np.random.default_rng(7).random((optics.views, 2))
    lobe_gain = _lobe_gain(optics)
    for tan_row, tan_col, weight, (jitter_row, jitter_col) in zip(*optics.pupil(), jitter, strict=True):
        # Each view's rays start a fraction of a pixel of its own aside, so that the shifts blur all frames alike.
        rows = (plane_um - z_um) * tan_row / scene.pixel_um
        cols = (plane_um - z_um) * tan_col / scene.pixel_um
        first_row, first_col = np.floor(rows.min()) - jitter_row, np.floor(cols.min()) - jitter_col
        size = n_rows + int(rows.max() - first_row) + 2, n_cols + int(cols.max() - first_col) + 2
        planes = np.empty((len(totals), *size), np.float32)
        trace_view(
            heights, scene.outline_um, scene.reflectance, scene.gloss, scene.lean_rows, scene.lean_cols, tops, bottoms,
            scene.wall_reflectance, scene.pixel_um, origin[0] + first_row, origin[1] + first_col, tan_row, tan_col,
            optics.lobe, lobe_gain, planes,
        )  # fmt: skip
        add_view(planes, rows - first_row, cols - first_col, weight, totals)
    frames = _without_ghosts(totals[:n_layers], totals[n_layers:], cell_px)
    point_px = optics.point_px(scene.pixel_um)
    light = np.stack([gaussian_filter(frame, point_px, truncate=TRUNCATE) for frame in frames])
    return light[:, halo : n_rows - halo, halo : n_cols - halo]


def _without_ghosts(
    light: NDArray[np.float32], shares: NDArray[np.float32], cell_px: NDArray[np.float64]
) -> Iterator[NDArray[np.float32]]:
    """Frames in which each view stands for its part of the pupil, not for a point of it.

    light: [layer, k, row, col]; shares: of the views that see a layer, [layer but the last, k, row, col]; cell_px: what
    a view's part of the pupil blurs a layer by, [layer, k]. The light of a layer, per view that sees it, is blurred by
    its own distance, and where one layer hides another by the distance of the layer that hides: a rim in focus is sharp
    before a ground that is not.
    """
    for k in range(light.shape[1]):
        if len(light) == 1:
            yield _blurred(light[0, k], cell_px[0, k])
            continue
        last = 1 - shares[:, k].sum(axis=0)
        total = np.zeros_like(last)
        for layer, share in enumerate((*shares[:, k], last)):
            seen = _blurred(share, cell_px[layer, k])
            brightness = _blurred(light[layer, k], cell_px[layer, k]) / np.maximum(seen, LEAST_SHARE)
            total += brightness * _blurred(share, cell_px[1:, k].min())
        yield total


def _blurred(frame: NDArray[np.float32], sigma_px: float) -> NDArray[np.float32]:
    return gaussian_filter(frame, sigma_px, truncate=TRUNCATE) if sigma_px > LEAST_BLUR_PX else frame


def _extents(scene: TruthScene, plane_um: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The highest and lowest point of each layer within its outline, over the plane where rays start."""
    inside = scene.outline_um < scene.pixel_um
    tops = np.where(inside, scene.height_um, -np.inf).max(axis=(1, 2)).astype(float) - plane_um
    bottoms = np.where(inside, scene.height_um, np.inf).min(axis=(1, 2)).astype(float) - plane_um
    return tops, bottoms


def _lobe_gain(optics: Optics) -> float:
    """What makes a level mirror as bright as a diffuse sheet of its reflectance."""
    tan_row, tan_col, weight = optics.pupil()
    return float(1 / np.sum(weight * np.exp(-(tan_row**2 + tan_col**2) / (2 * optics.lobe**2))))


def _cell_px(scene: TruthScene, optics: Optics, z_um: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sigma [layer, k] of the part of the pupil that one view stands for: it goes with the distance to the layer.

    Without it two hundred sharp ghosts of the layer would be seen.
    """
    tops, bottoms = _extents(scene, 0.0)
    away_um = np.maximum(0, np.maximum(bottoms[:, None] - z_um, z_um - tops[:, None]))
    return optics.cell_tangent * away_um / scene.pixel_um
