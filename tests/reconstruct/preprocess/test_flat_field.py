"""The flat field corrects the image of a field and leaves its heights alone."""

from __future__ import annotations

import dataclasses

import numpy as np

from tests.reconstruct.conftest import correction
from tests.support.wave_renderer import WaveRenderer
from wafer_viewer.model.acquisition.calibration import ImageShading
from wafer_viewer.model.acquisition.focus_stack import Bracket, FieldStack
from wafer_viewer.model.acquisition.plan import Field
from wafer_viewer.reconstruct.blending.stitched_mosaic import stitched_picture
from wafer_viewer.reconstruct.field_pipeline import prepare_field, reconstruct
from wafer_viewer.reconstruct.preprocess.exposure_fusion import Fusion, without_shading

SHAPE = (60, 80)
SENSITIVITY = np.tile(np.linspace(0.85, 1.15, SHAPE[1]), (SHAPE[0], 1)).astype(np.float32)
SHADING = ImageShading(SENSITIVITY, np.full(SHAPE, 6.0, np.float32))


def stack(shading=None, brackets=(), sensitivity=SENSITIVITY, dark=6):
    z_um = np.linspace(-10, 10, 21)
    renderer = WaveRenderer(shape=SHAPE)
    frames = np.stack([renderer.frame(0, 0, z, 100.0, k) * sensitivity + dark for k, z in enumerate(z_um)])
    field = Field(number=1, row=0, col=0, x_um=0.0, y_um=0.0, z_start_um=-10.0)
    images = frames.clip(0, 255).astype(np.uint8)
    return FieldStack(field, images, z_um, np.ones(21, bool), 0.467, shading=shading, brackets=brackets)


def unevenness(picture, even):
    """Relative spread of the ratio to the picture of an even camera, along the rows."""
    ratio = picture.astype(float).mean(axis=0) / even.astype(float).mean(axis=0)
    return float(ratio.std() / ratio.mean())


def test_an_image_is_that_of_an_even_camera():
    even = np.random.default_rng(0).integers(40, 200, SHAPE).astype(np.uint16)
    shaded = np.rint(even * SENSITIVITY + 6).astype(np.uint16)
    corrected = without_shading(shaded, SHADING)
    assert corrected.dtype == np.uint16
    assert np.abs(corrected.astype(int) - even).max() <= 1
    assert without_shading(shaded, None) is shaded
    black = without_shading(np.zeros(SHAPE, np.uint8), SHADING)
    assert black.max() == 0
    white = without_shading(np.full(SHAPE, 255, np.uint8), SHADING)
    assert white[:, 0].min() == 255


def test_the_image_is_corrected_and_the_heights_are_not_changed():
    raw, corrected = reconstruct(stack()), reconstruct(stack(SHADING))
    np.testing.assert_array_equal(raw.z_um, corrected.z_um)
    np.testing.assert_array_equal(raw.confidence, corrected.confidence)
    even = reconstruct(stack(sensitivity=1, dark=0)).all_in_focus
    assert unevenness(raw.all_in_focus, even) > 0.06
    assert unevenness(corrected.all_in_focus, even) < 0.01


def test_fused_exposures_are_corrected_in_their_own_counts():
    plain = stack(SHADING)
    longer = np.clip((plain.images.astype(float) - 6) * 1.6 + 6, 0, 255).astype(np.uint8)
    fused = stack(SHADING, (Bracket(longer, plain.present, 160.0),))
    assert correction(prepare_field(fused).frames, Fusion) is not None
    image = reconstruct(fused).all_in_focus
    assert image.dtype == np.uint16
    assert unevenness(image, reconstruct(stack(sensitivity=1, dark=0)).all_in_focus) < 0.02


def test_a_part_of_a_stack_has_its_part_of_the_shading():
    whole = stack(SHADING)
    part = whole.part(slice(10, 50), slice(20, 70))
    np.testing.assert_array_equal(part.shading.sensitivity, SENSITIVITY[10:50, 20:70])
    assert dataclasses.replace(whole, shading=None).part(slice(0, 9), slice(0, 9)).shading is None


def test_the_stitched_picture_at_one_z_is_corrected():
    raw, corrected = (stitched_picture([stack(shading)], 0.0)[0] for shading in (None, SHADING))
    even = stitched_picture([stack(sensitivity=1, dark=0)], 0.0)[0]
    assert unevenness(raw, even) > 0.06
    assert unevenness(corrected, even) < 0.01
