"""The Python API as a notebook has it."""

from __future__ import annotations

import inspect
import subprocess
import sys

import numpy as np
import pytest

import wafer_viewer as wv


def python(code):
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Frames of a textured step, 20 um high: z 12 on the left, 32 on the right."""
    import tifffile
    from scipy.ndimage import gaussian_filter

    folder = tmp_path_factory.mktemp("stack")
    texture = np.random.default_rng(1).normal(128, 60, (96, 160))
    for k in range(12):
        halves = [gaussian_filter(texture, 0.5 + 0.25 * abs(4.0 * k - z_um)) for z_um in (12.0, 32.0)]
        image = np.hstack([halves[0][:, :80], halves[1][:, 80:]])
        tifffile.imwrite(folder / f"frame{k}.tif", image.clip(0, 255).astype(np.uint8))
    return folder


def test_from_images_to_a_step_height(folder, tmp_path):
    stack = wv.open_stack(folder, z_step_um=4.0, pixel_um=0.5)
    height = wv.reconstruct(stack, wv.Recipe(focus_measure="sml", window=9))
    x0, y0, x1, y1 = height.bounds_um
    upper = wv.Region.rectangle(x1 - 25, y0 + 5, x1 - 5, y1 - 5)
    lower = wv.Region.rectangle(x0 + 5, y0 + 5, x0 + 25, y1 - 5)
    step = wv.step_height(height, upper=upper, lower=lower)
    assert step.height.value_um == pytest.approx(20.0, abs=0.5)
    assert step.height.status == "uncalibrated"
    assert step.height.expanded_um is None
    flat = wv.levelled(height, wv.Levelling(by="region", places=(lower,)))
    middle = wv.Region.point(x1 - 15, (y0 + y1) / 2)
    assert wv.point_height(flat, middle).main.value == pytest.approx(20.0, abs=1.0)
    assert wv.face_angle(height, upper, lower).angle.unit == "deg"
    assert wv.texture(height, upper).sq.value_um <= wv.flatness(height, upper).flt_t.value_um
    found, curve = wv.profile(height, wv.Region.line(x0 + 5, 0, x1 - 5, 0, width_um=5))
    assert found.rise.value_um == pytest.approx(20.0, abs=1.0)
    assert len(curve.z_um) == len(curve.distance_um)
    why = wv.focus_curve(stack, x1 - 15, 0.0, height.provenance.recipe)
    assert isinstance(why, wv.FocusCurve)
    assert why.peak_z_um == pytest.approx(32.0, abs=1.0)
    back = wv.read_npz(wv.export(height, tmp_path / "step.npz"))
    np.testing.assert_array_equal(back.z_um, height.z_um)


def test_two_fields_become_one_surface(folder):
    stack = wv.open_stack(folder, z_step_um=4.0, pixel_um=0.5)
    height = wv.reconstruct(stack, wv.Recipe(window=9))
    fields = [wv.Field(number=n, row=0, col=n - 1, x_um=60.0 * (n - 1), y_um=0.0, z_start_um=0.0) for n in (1, 2)]
    mosaic = wv.stitch([height, height], fields, wv.Recipe())
    assert mosaic.shape == (96, 280)


def test_a_dataset_is_opened_by_its_path(folder, tmp_path):
    wv.import_dataset(folder, tmp_path / "taken.wafer", z_step_um=4.0, pixel_um=0.5)
    data = wv.Dataset.open(tmp_path / "taken.wafer")
    assert data.stack(1).images.shape == (12, 96, 160)
    with pytest.raises(wv.WaferViewerError, match="does not exist"):
        wv.Dataset.open(tmp_path / "nothing.wafer")


def test_every_name_is_there_and_listed():
    assert not [name for name in wv.__all__ if getattr(wv, name) is None or name not in dir(wv)]


def test_a_name_that_is_not_there_is_an_attribute_error():
    with pytest.raises(AttributeError, match="No wafer_viewer attribute reconstrukt"):
        wv.reconstrukt  # noqa: B018


@pytest.mark.slow
@pytest.mark.parametrize(
    "first",
    ["wv.stitch", "wv.reconstruct", "__import__('wafer_viewer.reconstruct.blending.stitched_mosaic')", "wv.Session"],
)
def test_reconstruct_is_the_function_whatever_was_imported_before(first):
    assert python(f"import wafer_viewer as wv; {first}; print(callable(wv.reconstruct))") == "True"


def test_a_function_of_the_api_has_sections_which_the_linter_checks() -> None:
    functions = [name for name in wv.__all__ if inspect.isfunction(getattr(wv, name))]
    assert len(functions) > 40
    assert not [name for name in functions if "\n\nParameters\n----------\n" not in inspect.getdoc(getattr(wv, name))]
