"""The Python API as a notebook has it."""

from __future__ import annotations

import inspect
import subprocess
import sys

import numpy as np
import pytest
from scipy import stats

import wafer_viewer as wv
from tests.support.surfaces import gauge_blocks
from wafer_viewer.cli.app import main


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


def step_and_surface():
    surface = gauge_blocks(1)
    x0, y0, x1, y1 = surface.bounds_um
    upper = wv.Region.rectangle(10, y0 + 5, x1 - 5, y1 - 5)
    lower = wv.Region.rectangle(x0 + 5, y0 + 5, -10, y1 - 5)
    return surface, wv.step_height(surface, upper, lower, name="blocks")


def test_a_result_is_a_number_with_its_uncertainty():
    _, step = step_and_surface()
    assert float(step) == float(step.height) == step.height.value_um
    assert step.u == step.height.u == pytest.approx(step.height.expanded_um / step.height.k)
    assert step.u == pytest.approx(np.sqrt(sum(line.u_um**2 for line in step.height.budget)))
    uncertain, certain = wv.Quantity(value=1.5, unit="mrad"), wv.Length(value_um=30.0371, expanded_um=0.118)
    assert (uncertain.u, str(uncertain), str(certain)) == (None, "1.500 mrad", "30.04 ± 0.12 um")


@pytest.mark.slow
def test_a_result_is_a_dictionary_and_a_table():
    _, step = step_and_surface()
    data = step.to_dict()
    assert (data["name"], data["upper"]["kind"]) == ("blocks", "rectangle")
    height = data["height"]
    assert (height["value"], height["unit"], height["u"]) == (float(step), "um", step.u)
    assert height["expanded"] == pytest.approx(height["k"] * step.u)
    lines = {line["name"]: line for line in height["budget"]}
    assert sum(line["u"] ** 2 for line in lines.values()) == pytest.approx(step.u**2)
    noise, scale = lines["noise and form of the faces"], lines["z scale"]
    assert (noise["evaluation"], noise["distribution"]) == ("A", "normal")
    assert (scale["evaluation"], scale["freedom"]) == ("B", None)
    assert lines["interpolation between frames"]["distribution"] == "triangular"
    assert height["freedom"] == pytest.approx(step.u**4 / (noise["u"] ** 4 / noise["freedom"]))
    covered = stats.t.cdf(height["k"], height["freedom"]) - stats.t.cdf(-height["k"], height["freedom"])
    assert covered == pytest.approx(height["coverage"], rel=1e-9)
    table = step.to_frame()
    assert list(table.index) == ["height", "at_joint", "tilt"]
    assert table.loc["height", "u"] == step.u
    assert table.loc["tilt", "unit"] == "mrad"


def test_a_table_without_pandas_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(wv.WaferViewerError, match="pip install pandas"):
        step_and_surface()[1].to_frame()


def test_results_and_surfaces_are_shown_in_three_lines():
    surface, step = step_and_surface()
    first, second, third = repr(step).splitlines()
    assert first.startswith(f"StepHeight: height {step.height} (k = {step.height.k:.3g})")
    assert "tilt" in second
    assert third.strip() == "blocks; unsmoothed heights; 3 notes"
    first, second, third = repr(surface).splitlines()
    assert first == "HeightMap: 240 x 640 pixels of 0.5 um"
    assert "x -159.8 to 159.8 um, y -59.8 to 59.8 um" in second
    assert third == "  100.0 % measured"


def test_numpy_takes_a_surface_for_its_heights(folder):
    stack = wv.open_stack(folder, z_step_um=4.0, pixel_um=0.5)
    height = wv.reconstruct(stack, wv.Recipe(window=9))
    assert np.shares_memory(np.asarray(height), height.z_raw_um)
    assert np.asarray(height, np.float64).dtype == np.float64
    assert not np.shares_memory(np.array(height), height.z_raw_um)
    datum = wv.levelled(height, wv.Levelling(by="plane"))
    fields = [wv.Field(number=1, row=0, col=0, x_um=0.0, y_um=0.0, z_start_um=0.0)]
    for surface in (datum, wv.stitch([height], fields), wv.compare(height, height)):
        np.testing.assert_array_equal(np.asarray(surface), surface.window().to_measure())


def test_a_surface_is_read_from_a_dataset_and_a_file_alike(folder, tmp_path):
    stack = wv.open_stack(folder, z_step_um=4.0, pixel_um=0.5)
    height = wv.reconstruct(stack, wv.Recipe(window=9))
    assert main(["import", str(wv.export(height, tmp_path / "s.x3p")), "-o", str(tmp_path / "s.wafer")]) == 0
    read = wv.read_surface(tmp_path / "s.wafer")
    np.testing.assert_allclose(read.z_um, wv.read_surface(tmp_path / "s.x3p").z_um, atol=1e-4)
    with pytest.raises(wv.WaferViewerError, match="states its own units: leave"):
        wv.read_surface(tmp_path / "s.wafer", pixel_um=0.5)
    with pytest.raises(wv.WaferViewerError, match="does not exist"):
        wv.read_surface(tmp_path / "none.wafer")


WORDS = {
    "area_volume": "reference",
    "chipping": "die",
    "circle_size": "inside",
    "coplanarity": "reference",
    "die_size": "die",
    "find_dies": "evidence",
    "fitted_dies": "evidence",
    "gauge_rr": "method",
    "kerf_width": "kerf",
    "step_height": "definition",
    "step_profile": "shape",
    "study_rr": "method",
}


@pytest.mark.parametrize(("function", "argument"), WORDS.items())
def test_a_wrong_word_is_named_with_those_that_may_be_given(function, argument):
    called = getattr(wv, function)
    required = [p for p in inspect.signature(called).parameters.values() if p.default is p.empty]
    with pytest.raises(wv.WaferViewerError, match=f"^{argument} is 'soup': it must be one of '"):
        called(*[None] * len(required), **{argument: "soup"})


def test_a_wrong_layer_is_named_with_the_layers():
    surface, _ = step_and_surface()
    with pytest.raises(wv.WaferViewerError, match=r"^layer is 'soup': it must be one of 'unsmoothed', 'smoothed'"):
        wv.point_height(surface, wv.Region.point(0, 0), layer="soup")


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


@pytest.mark.campaign(at_least_one=True)
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
