"""A focus measure of another package, one file of the documentation, is known and used everywhere."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from scipy import ndimage

from tests.support.documentation import code_block
from tests.support.paths import ROOT
from tests.support.plugin_packages import run_with, write_package
from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.errors import ComputeError
from wafer_viewer.model.plugins import PluginWarning
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.focus_measures import BUILT_IN, FocusMeasure, focus_measures
from wafer_viewer.reconstruct.focus import peak_search
from wafer_viewer.reconstruct.focus.focus_measures import focus_kernels
from wafer_viewer.reconstruct.focus.peak import Peaks
from wafer_viewer.reconstruct.focus.peak_search import Search, ThreadScratch, noise_scores, search_block, search_field
from wafer_viewer.reconstruct.frame_blocks import StackSource, StackWindow, developed
from wafer_viewer.reconstruct.preprocess.frames import prepare

NAME = "laplacian_variance"
OF_THE_PAGE = code_block("how-to/extend.md", '"""Variance of the Laplacian')
USE = """
import json, sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
import wafer_viewer as wv
from wafer_viewer.draw.quantities import recipe_rows
from wafer_viewer.gui.steps.surface.reconstruction import summary
from wafer_viewer.model.spec import settings_of
from wafer_viewer.reconstruct.live_field import LiveField

stack = wv.open_stack(sys.argv[1], z_step_um=4.0, pixel_um=0.5, z_start_um=20.0)
recipe = wv.Recipe(focus_measure="laplacian_variance")
height = wv.reconstruct(stack, recipe, threads=2)
settled = height.provenance.recipe
live = LiveField(stack.images, 4.0, settled)
live.take(8, stack.n_frames)
live.take(0, 8)
pixel = wv.focus_curve(stack, stack.x0_um + 20, stack.y0_um - 20, settled)
with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as other:
    elsewhere = other.submit(wv.reconstruct, stack, settled).result()
noise = np.clip(np.random.default_rng(5).normal(128, 3, stack.images.shape), 0, 255).astype(np.uint8)
of_noise = wv.reconstruct(wv.FieldStack(stack.field, noise, stack.z_um, stack.present, 0.5), recipe)
try:
    wv.Recipe(focus_measure="sharpness")
except wv.WaferViewerError as fault:
    refusal = str(fault)
np.save(sys.argv[2], height.z_raw_um)
print(json.dumps({
    "window": settled.window,
    "has_auto": settled.heights_have_auto,
    "live": bool(np.array_equal(live.surface(stack).z_um, height.z_um, equal_nan=True)),
    "elsewhere": bool(np.array_equal(elsewhere.z_um, height.z_um, equal_nan=True)),
    "pixel": [pixel.height_um, float(height.z_raw_um[pixel.row, pixel.col])],
    "of_noise": float(np.isfinite(of_noise.z_raw_um).mean()),
    "choices": dict(settings_of(wv.Recipe)["focus_measure"].setting.titles),
    "summary": summary(settled),
    "report": dict(recipe_rows(settled))["Focus measure"],
    "refusal": refusal,
}))
"""


def install(folder: Path) -> Path:
    return write_package(folder, NAME, OF_THE_PAGE, {"focus_measures": f"{NAME} = {NAME}:MEASURE"})


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return install(tmp_path_factory.mktemp("packages"))


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory, plane_stack: FieldStack) -> Path:
    file = tmp_path_factory.mktemp("stack") / "plane.tif"
    tifffile.imwrite(file, plane_stack.images, photometric="minisblack")
    return file


def assert_is_plane(z_um: NDArray, plane_um: NDArray) -> None:
    valid = np.isfinite(z_um)
    assert valid.mean() > 0.9
    assert np.sqrt(np.mean((z_um - plane_um)[valid] ** 2)) < 0.5


@pytest.mark.slow
def test_it_is_known_and_used_everywhere(
    installed: Path, pages: Path, tmp_path: Path, plane_um: NDArray[np.float64]
) -> None:
    found = json.loads(run_with(installed, "-W", "error", "-c", USE, str(pages), str(tmp_path / "z.npy")).stdout)
    assert_is_plane(np.load(tmp_path / "z.npy"), plane_um)
    assert not found["has_auto"]
    assert found["window"] in (9, 13, 17)
    assert found["live"]
    assert found["elsewhere"]
    assert found["pixel"][0] == pytest.approx(found["pixel"][1], abs=0.2)
    assert found["of_noise"] < 0.01
    assert found["choices"][NAME] == "Laplacian variance"
    assert found["summary"].startswith("Laplacian variance · window")
    assert found["report"] == "Laplacian variance: variance of the Laplacian over the window"
    assert found["refusal"].startswith("Recipe.focus_measure is 'sharpness': it must be one of 'log_laplacian', ")
    assert f"'{NAME}'" in found["refusal"]


@pytest.mark.campaign
def test_the_command_line_takes_it(installed: Path, pages: Path, tmp_path: Path, plane_um: NDArray[np.float64]) -> None:
    out = tmp_path / "z.npz"
    words = ["reconstruct", pages, "--z-step-um", 4, "--pixel-um", 0.5, "-o", out]
    flag = "--recipe.focus-measure"
    run_with(installed, "-W", "error", "-m", "wafer_viewer", *map(str, words), flag, NAME)
    with np.load(out) as stored:
        assert json.loads(str(stored["provenance"]))["recipe"]["focus_measure"] == NAME
        assert_is_plane(stored["z_um"] + 20, plane_um)
    refused = run_with(installed, "-m", "wafer_viewer", *map(str, words), flag, "sharpness", check=False)
    assert refused.returncode == 2
    assert f"it must be one of log_laplacian, tenengrad, sml, glv, {NAME};" in refused.stderr


@pytest.fixture
def added(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Add a focus measure with this plain function to the table."""

    def add(function, **properties: object) -> None:
        module = type(sys)("of_a_test")
        module.focus = function
        monkeypatch.setitem(sys.modules, "of_a_test", module)
        measure = FocusMeasure(
            name="own", title="Own", description="", implementation="of_a_test:focus", power=2.0, **properties
        )
        monkeypatch.setitem(focus_measures(), "own", measure)

    yield add
    focus_kernels.cache_clear()
    peak_search._noise_scores.cache_clear()


def contrast(image: NDArray, window: int) -> NDArray:
    """Range of the gradient, which has no rounding errors, over the window."""
    slope = np.abs(ndimage.prewitt(image))
    return ndimage.maximum_filter(slope, window)


@pytest.mark.slow
def test_blocks_equal_the_whole_frame(added, plane_stack: FieldStack) -> None:
    added(contrast)
    frames, search = prepare(plane_stack), Search("own", 9, "argmax", 4)
    full = np.stack(
        [contrast(np.pad(image.astype(np.float32), 5, "edge"), 9)[5:-5, 5:-5] for image in plane_stack.images]
    )
    expected = np.rint(512 * (np.log2(full) + 64)).astype(int)
    n_rows, cols = frames.shape
    for rows, columns in ((0, 0), (3, 90), (40, 61), (n_rows - 32, cols - 32), (0, cols - 32)):
        part = StackWindow(slice(rows, rows + 32), slice(columns, columns + 32))
        bench = ThreadScratch.make(frames.n_frames, (32, 32), search, frames.dtype)
        for _, block in developed(frames, [part], search.margin_px):
            search_block(block, frames.z_um, search, bench, Peaks.empty((32, 32), frames.dtype))
        np.testing.assert_array_equal(bench.curves.levels, expected[:, part.rows, part.cols])


def test_stripes_and_threads_leave_no_seam(added, plane_stack: FieldStack, monkeypatch: pytest.MonkeyPatch) -> None:
    added(contrast)
    frames, search = prepare(plane_stack), Search("own", 9, "blur_law", 4, blend=1)
    one = search_field(frames, search, threads=2)
    monkeypatch.setattr(peak_search, "STRIPE_ROWS", 20)
    other = search_field(frames, search, threads=1)
    for name in ("z_um", "lead", "fall", "contrast", "clipped", "all_in_focus", "coarse"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_what_no_focus_looks_like_is_the_lowest_level(added) -> None:
    values = np.array([[0.0, -1.0, np.nan, 1.0, 2.0**-70, 2.0**70, np.inf]])
    added(lambda image, window: values, taps_px=0, passes=1)
    search = Search("own", 1, "argmax", 1)
    source = StackSource.of(np.zeros((3, 1, 7), np.uint8), np.arange(3), 0, 0, 256)
    bench = ThreadScratch.make(3, (1, 7), search, np.dtype(np.uint8))
    search_block(source, np.arange(3.0), search, bench, Peaks.empty((1, 7), np.dtype(np.uint8)))
    assert bench.curves.levels[0, 0].tolist() == [0, 0, 0, 64 * 512, 0, 65535, 65535]


def test_peaks_of_pure_noise_are_simulated_for_it(added) -> None:
    added(lambda image, window: ndimage.uniform_filter(ndimage.laplace(image) ** 2, window))
    narrow, wide = (noise_scores(Search("own", window, "argmax", 3), 30) for window in (5, 13))
    of_sml = noise_scores(Search("sml", 5, "argmax", 3), 30)
    assert wide.lead < narrow.lead
    assert narrow.lead == pytest.approx(of_sml.lead, rel=0.3)


def test_one_that_asks_for_it_gets_the_grey_in_units_of_the_noise(added) -> None:
    observed: list[float] = []

    def spread(image: NDArray, window: int) -> NDArray:
        observed.append(float(image.std()))
        return image

    added(spread, uses_camera_noise=True)
    noise_scores(Search("own", 9, "argmax", 3), 12)
    assert observed == pytest.approx([1.0] * 12, abs=0.05)


def test_one_that_cannot_be_used_is_named(added, plane_stack: FieldStack) -> None:
    frames, search = prepare(plane_stack), Search("own", 9, "argmax", 4)
    added(lambda image, window: image[1:])
    with pytest.raises(ComputeError, match=r"'own' returns an array of shape .* one value for each pixel"):
        search_field(frames, search, threads=1)
    focus_kernels.cache_clear()
    focus_measures()["own"] = replace(focus_measures()["own"], implementation="of_a_test:fokus")
    with pytest.raises(ComputeError, match=r"'own' cannot be imported from of_a_test:fokus .*: update or remove"):
        search_field(frames, search, threads=1)


def test_a_name_or_title_that_is_taken_is_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    source = (
        "from wafer_viewer.model.spec import replace\n"
        "from wafer_viewer.model.surface.focus_measures import BUILT_IN\n"
        "MEASURE = replace(BUILT_IN[0], name='another')\n"
    )
    write_package(tmp_path, "brings_a_twin", source, {"focus_measures": "twin = brings_a_twin:MEASURE"})
    with pytest.warns(PluginWarning, match="titled 'Log-Laplacian'"):
        found = focus_measures.__wrapped__()
    assert list(found) == [measure.name for measure in BUILT_IN]


def test_the_page_on_heights_describes_the_built_in_ones() -> None:
    text = (ROOT / "assets/docs/explanation/heights.md").read_text()
    assert all(f"`{measure.name}` ({measure.description})" in text for measure in BUILT_IN)
