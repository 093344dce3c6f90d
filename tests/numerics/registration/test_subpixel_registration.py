"""A shift to a small part of a pixel, and an uncertainty that is that of the errors."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import affine_transform, gaussian_filter, map_coordinates
from scipy.special import erf

from wafer_viewer.numerics import block_gradients
from wafer_viewer.numerics.block_sums import block_sums, smoothed, taps
from wafer_viewer.numerics.subpixel_registration import RegisteredImage, align

SHAPE = 160, 90


def picture(values: NDArray, valid: NDArray | None = None, noise: float = 0.1) -> RegisteredImage:
    mask = np.ones(values.shape) if valid is None else valid
    return RegisteredImage(values.astype(np.float32), mask.astype(np.float32), noise)


def two(
    off: tuple[float, float], noise: float, noise_blur: float = 0.0, seed: int = 0
) -> tuple[RegisteredImage, RegisteredImage]:
    """A texture and what a camera sees of it that looks `off` further on, each with noise of its own."""
    rng = np.random.default_rng(seed)
    texture = gaussian_filter(rng.normal(size=(SHAPE[0] + 20, SHAPE[1] + 20)), 1.3, mode="wrap")
    down, right = (np.fft.fftfreq(n) for n in texture.shape)
    turn = np.exp(2j * np.pi * (down[:, None] * off[0] + right * off[1]))
    moved = np.fft.ifft2(np.fft.fft2(texture) * turn).real

    def seen(of: NDArray) -> NDArray:
        dirt = gaussian_filter(rng.normal(size=SHAPE), noise_blur)
        return (of / texture.std())[10:-10, 10:-10] + noise * dirt / dirt.std()

    return picture(seen(texture), noise=noise), picture(1.4 * seen(moved) - 3, noise=1.4 * noise)


@pytest.mark.parametrize("part", [-0.5, -0.2, 0.0, 0.37, 0.5])
def test_reading_between_pixels_keeps_a_plane(part):
    value, slope = taps(part)
    away = np.arange(-3, 4)
    assert value.sum() == pytest.approx(1, abs=1e-6)
    assert slope.sum() == pytest.approx(0, abs=1e-6)
    assert value @ away == pytest.approx(part, abs=3e-3)
    assert slope @ away == pytest.approx(1, abs=1e-5)


def test_sums_of_blocks_are_those_of_the_pixels():
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(2, 50, 41)).astype(np.float32)
    valid = (rng.random((50, 41)) < 0.8).astype(np.float32)
    sums = block_sums(smoothed(a), valid, b, np.ones_like(b), (4.0, -3.0), 12)
    assert sums.shape == (3, 2, 7, 7)
    assert sums[:, :, 0, 0].sum() == valid[7:47, 3:35].sum()
    smooth = np.stack([np.convolve(row, taps(0)[0], "valid") for row in a])
    smooth = np.stack([np.convolve(col, taps(0)[0], "valid") for col in smooth.T]).T
    inner = valid[7:47, 3:35]
    np.testing.assert_allclose(sums[:, :, 0, 3].sum(), (smooth[4:44, :32] * inner).sum(), rtol=1e-4)
    np.testing.assert_allclose(sums[:, :, 3, 3].sum(), (smooth[4:44, :32] ** 2 * inner).sum(), rtol=1e-4)
    row, col = np.arange(40)[:, None] % (40 / 3) * 3 / 40 - 0.5, np.arange(32) % 16 / 16 - 0.5
    for line, of in ((1, row + 0 * col), (2, col + 0 * row)):
        np.testing.assert_allclose(sums[:, :, 0, line].sum(), (of * inner).sum(), rtol=1e-4)
        np.testing.assert_allclose(sums[:, :, line, 3].sum(), (of * smooth[4:44, :32] * inner).sum(), rtol=1e-4)
    np.testing.assert_allclose(sums[:, :, 1, 2].sum(), (row * col * inner).sum(), rtol=1e-4)
    np.testing.assert_allclose(sums[:, :, 2, 2].sum(), (col**2 * inner).sum(), rtol=1e-4)
    np.testing.assert_array_equal(sums, sums.swapaxes(2, 3))


def test_surfaces_without_overlap_give_no_measurement():
    first, second = two((0, 0), 0.1)
    found = align(first, second, (0.0, 300.0), 20)
    assert np.isinf(found.covariance).all()
    assert (found.correlation, found.n_pixels) == (0, 0)


@pytest.mark.parametrize(("noise", "noise_blur"), [(0.1, 0), (1.0, 0), (2.0, 0), (1.0, 1.5)])
def test_the_uncertainty_is_that_of_the_errors(noise, noise_blur):
    rng = np.random.default_rng(1)
    normalised = []
    for seed in range(40):
        off = tuple(rng.uniform(-0.8, 0.8, 2))
        found = align(*two(off, noise, noise_blur, seed), (0.0, 0.0), 20)
        normalised.append((np.array(found.lag) - off) / np.sqrt(np.diag(found.covariance)))
    assert 0.6 < np.sqrt(np.mean(np.square(normalised))) < 1.35
    assert np.abs(np.mean(normalised, axis=0)).max() < 0.5


def test_parts_that_are_displaced_against_each_other_make_the_lag_less_sure():
    """As in a picture whose parts come from different frames."""
    rng = np.random.default_rng(1)
    rows, cols = np.indices(SHAPE, dtype=float)
    normalised = []
    for _ in range(24):
        texture = gaussian_filter(rng.normal(size=SHAPE), 1.5, mode="wrap")
        texture /= texture.std()
        moved = 0.1 * np.sin(2 * np.pi * (rows / 300 + rng.random()))
        seen = map_coordinates(texture, (rows, cols + moved), order=3, mode="wrap")
        found = align(*(picture(one + rng.normal(0, 0.1, SHAPE)) for one in (texture, seen)), (0.0, 0.0), 20)
        normalised.append(found.lag[1] / np.sqrt(found.covariance[1, 1]))
    assert 0.5 < np.sqrt(np.mean(np.square(normalised))) < 1.4


def test_noise_does_not_pull_to_the_middle_between_pixels():
    errors = [np.array(align(*two((0.25, 0.25), 1.0, 0.0, seed), (0.0, 0.0), 20).lag) - 0.25 for seed in range(60)]
    assert np.abs(np.mean(errors)) < 0.005


def test_along_lines_nothing_is_known():
    rng = np.random.default_rng(0)
    lines = np.tile(np.sin(np.arange(SHAPE[1]) / 2), (SHAPE[0], 1))
    found = align(*(picture(lines + rng.normal(0, 0.1, SHAPE)) for _ in range(2)), (0.0, 0.0), 20)
    assert not np.sqrt(found.covariance[0, 0]) < 0.3


@pytest.mark.parametrize("edge_row", [1.5, 2.5])
def test_an_edge_that_the_border_of_a_strip_cuts_is_followed_to_its_place(edge_row):
    """A shift of such an edge changes the contrast of its block too, which a block has for itself."""
    rng = np.random.default_rng(0)
    rows, cols = np.indices((40, 160))

    def seen(off: float) -> RegisteredImage:
        edge = erf((rows - edge_row + off - 0.002 * cols) / 1.8)
        across = 0.3 * erf((cols - 80 - 20 * np.sin(rows / 9)) / 1.8)
        return picture(edge + across + rng.normal(0, 0.02, rows.shape), noise=0.02)

    first, second = seen(0.0), seen(0.6)
    ends = [align(first, second, (begun, 0.0), 20) for begun in (0.0, 0.3, 1.0)]
    assert np.ptp([end.lag[0] for end in ends]) < 0.1
    assert all(np.sqrt(end.covariance[0, 0]) < 0.2 for end in ends)


def test_pixels_that_are_not_known_count_nothing():
    first, second = two((0.4, -0.3), 0.05)
    rng = np.random.default_rng(0)
    valid = rng.random(SHAPE) < 0.9
    valid[60:90] = False
    spoilt = np.where(valid, second.values, second.values.mean())
    found = align(first, picture(spoilt, valid), (0.0, 0.0), 20)
    full = align(first, second, (0.0, 0.0), 20)
    assert found.n_pixels < 0.8 * full.n_pixels
    assert np.abs(np.array(found.lag) - (0.4, -0.3)).max() < 0.08


def test_a_picture_that_is_turned_is_bent():
    first, second = two((0, 0), 0.1)
    angle = 0.006
    turn = np.array([[1, -angle], [angle, 1]])
    middle = (np.array(SHAPE) - 1) / 2
    turned = affine_transform(second.values, turn, middle - turn @ middle, order=3, mode="reflect")
    found = align(first, picture(turned), (0.0, 0.0), 20)
    assert found.bent_px == pytest.approx(angle * SHAPE[0] / 2, rel=0.3)
    assert found.bent_sigmas > 6
    assert align(first, second, (0.0, 0.0), 20).bent_sigmas < 4


def test_light_that_falls_off_moves_nothing():
    """A pattern of few, strong edges under a light that falls by a third across the overlap."""
    pattern = 40 * np.sign(np.sin(np.arange(SHAPE[0]) / 9)[:, None] + np.sin(np.arange(SHAPE[1]) / 7))
    rng = np.random.default_rng(0)
    first, second = (100 + gaussian_filter(pattern, 1.5) + rng.normal(0, 0.5, SHAPE) for _ in range(2))
    falls = 1 - 0.3 * np.linspace(0, 1, SHAPE[1]) ** 2
    lit = (np.log(np.maximum(grey, 4)) for grey in (first * falls, second * falls[::-1]))
    found = align(*(picture(grey - grey.mean(), noise=0.01) for grey in lit), (0.0, 0.0), 20)
    assert np.abs(found.lag).max() < 0.02
    assert np.abs(found.lag).max() < 4 * np.sqrt(np.diag(found.covariance)).max()


def test_where_only_a_part_fits_little_agrees():
    first, second = two((0, 0), 0.1)
    other, _ = two((0, 0), 0.1, seed=9)
    mixed = np.where(np.arange(SHAPE[0])[:, None] < 60, second.values, 1.4 * other.values)
    assert align(first, picture(mixed), (0.0, 0.0), 20).agreeing < 0.5
    assert align(first, second, (0.0, 0.0), 20).agreeing > 0.95


def test_one_block_is_compiled_for_with_several() -> None:
    first, second = two((0.3, 0.2), 0.05)
    assert [align(first, second, (0.0, 0.0), side).n_blocks == 1 for side in (200, 24)] == [True, False]
    assert len(block_gradients._agreement.signatures) == 1
