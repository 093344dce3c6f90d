"""Orders that the images contradict, and right ones that they do not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from tests.truth.unseen import drawn_scene
from wafer_viewer.numerics.frame_sequence import contradicting_order, place_sharpness

N = 20
LEVELS = np.linspace(0, 6, 13)


def sharpness(tilt: float, seed: int = 0, noise: float = 2.0) -> np.ndarray:
    """Of a tilted texture; without tilt all places are in focus at once."""
    rng = np.random.default_rng(seed)
    texture = gaussian_filter(rng.normal(size=(128, 160)), 0.7)
    blurred = np.stack([gaussian_filter(texture, level) if level else texture for level in LEVELS])
    at = 9.5 + tilt * np.linspace(-1, 1, 160)[None] * np.ones((128, 1))
    rows, cols = np.mgrid[:128, :160]
    frames = [blurred[np.clip(np.rint(1.6 * np.abs(k - at)), 0, 12).astype(int), rows, cols] for k in range(N)]
    grey = [(120 + 60 * frame + rng.normal(0, noise, frame.shape)).clip(0, 255).astype(np.uint8) for frame in frames]
    return np.stack([place_sharpness(frame) for frame in grey])


SPOILT = {
    "a counter that began anew": [*range(8, N), *range(8)],
    "signs are not read": [*range(9, -1, -1), *range(10, N)],
    "sorted as text": sorted(range(N), key=str),
    "sorted as text from 1": sorted(range(N), key=lambda k: str(k + 1)),
}


@pytest.mark.parametrize("spoilt", SPOILT.values(), ids=SPOILT)
def test_order_that_the_images_contradict_is_mended(spoilt):
    found = contradicting_order(sharpness(8.0)[spoilt])
    assert found is not None
    mended = [spoilt[k] for k in found.order]
    assert mended in (list(range(N)), list(range(N))[::-1])
    assert found.dips < found.dips_given


@pytest.mark.parametrize("tilt", [0.0, 2.0, 8.0])
def test_right_order_is_not_doubted(tilt):
    right = sharpness(tilt)
    assert contradicting_order(right) is None
    assert contradicting_order(right[::-1]) is None
    assert contradicting_order(right[::2]) is None


def test_images_without_texture_support_no_order():
    blank = np.random.default_rng(1).normal(100, 2, (N, 96, 96)).clip(0, 255).astype(np.uint8)
    assert contradicting_order(np.stack([place_sharpness(image) for image in blank])) is None


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize("seed", range(9_000_100, 9_000_108))
def test_right_order_of_hard_scenes_is_not_doubted(seed):
    images = drawn_scene(seed).stack.images
    assert contradicting_order(np.stack([place_sharpness(image) for image in images])) is None
