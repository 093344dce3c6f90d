"""A stack of every format is read as it was written, with what its files state."""

from __future__ import annotations

import re
import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from tests.support.paths import ROOT
from tests.support.written_images import BYTES, EXPOSURE_MS, PIXEL_UM, REASON, STEP_UM, WRITERS, video
from wafer_viewer.cli.app import main
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.image_formats import IMAGE_FORMATS, READ
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.preview import preview
from wafer_viewer.store.dataset.stack_import import import_dataset, open_stack
from wafer_viewer.store.images.camera_files import _numbers_of_frames
from wafer_viewer.store.images.image_files import planes_of

N, ROWS, COLS = 6, 48, 64
SILENT = {"png", "jpeg", "bmp", "pgm", "webp", "dng"}
"""Formats without lengths."""
GREEN = {"dng": lambda values: np.stack([values[:, ::2, 1::2], values[:, 1::2, ::2]])}
"""Measured pixels of formats that hold one colour a pixel."""


def images(name):
    dtype = np.uint8 if name in BYTES else np.uint16
    return np.random.default_rng(3).integers(0, 200, (N, ROWS, COLS)).astype(dtype) * dtype(1 if name in BYTES else 250)


@pytest.mark.slow
@pytest.mark.parametrize("name", WRITERS)
def test_stack_is_read_as_it_was_written(tmp_path, name):
    given = {"z_step_um": STEP_UM} if name in {*SILENT, "video"} else {}
    given |= {"pixel_um": PIXEL_UM} if name in {*SILENT, "video"} else {}
    stack = open_stack(WRITERS[name](tmp_path, images(name), ""), **given)
    read, written = (GREEN[name](values) if name in GREEN else values for values in (stack.images, images(name)))
    np.testing.assert_allclose(read, written, atol=6 if name == "jpeg" else 0)
    np.testing.assert_allclose(stack.z_um, STEP_UM * np.arange(N))
    assert stack.pixel_um == pytest.approx(PIXEL_UM)
    if name in ("ndtiff", "dng"):
        assert stack.exposure_us == pytest.approx(1e3 * EXPOSURE_MS)


def test_documentation_names_every_format():
    text = (ROOT / "assets/docs/how-to/import-images.md").read_text(encoding="utf-8")
    table = text[text.index("## Formats") :]
    assert [suffix for suffix in READ if not re.search(rf"{re.escape(suffix)}\b", table)] == []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["czi", "zarr_05", "video", "ndtiff"])
def test_commands_take_every_kind_of_source(tmp_path, name, capsys):
    path = WRITERS[name](tmp_path, images(name), "")
    given = ["--z-step-um", "2.5", "--pixel-um", "0.65"] if name == "video" else []
    assert main(["import", str(path), "-o", str(tmp_path / "a.wafer"), *given]) == 0
    np.testing.assert_array_equal(Dataset.open(tmp_path / "a.wafer").stack(1).images, images(name))
    assert len(preview(path)) > 100


@pytest.mark.parametrize("kind", [one for one in IMAGE_FORMATS if one.library], ids=lambda kind: kind.library)
def test_missing_library_is_named_with_what_to_install(tmp_path, kind, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, kind.library, None)
    path = tmp_path / f"a{kind.suffixes[0]}"
    path.write_bytes(bytes(64))
    expected = rf"^a{kind.suffixes[0]} is an? {kind.title}: pip install 'wafer-viewer\[images\]' to read it\."
    with pytest.raises(DatasetError, match=expected):
        open_stack(path)
    assert main(["import", str(path), "-o", str(tmp_path / "a.wafer")]) == 2


@pytest.mark.parametrize("kind", [one for one in IMAGE_FORMATS if one.library], ids=lambda kind: kind.library)
def test_damaged_file_is_named(tmp_path, kind):
    pytest.importorskip(kind.library, reason=REASON)
    path = tmp_path / f"a{kind.suffixes[0]}"
    path.write_bytes(np.random.default_rng(1).bytes(5000))
    with pytest.raises(DatasetError, match=f"^Import stopped at {path.name}: it is damaged, or not an image"):
        open_stack(path)


def test_scenes_and_channels_of_a_czi_file(tmp_path):
    api = pytest.importorskip("pylibCZIrw.czi", reason=REASON)
    path = tmp_path / "scenes.czi"
    with api.create_czi(str(path)) as file:
        for scene, x in enumerate((0, COLS - 8)):
            for channel in range(2):
                for k, image in enumerate(images("czi")):
                    values = np.ascontiguousarray(image[:, :, None] + np.uint16(10 * scene + channel))
                    file.write(values, location=(x, 0), plane={"Z": k, "C": channel, "T": 0}, scene=scene)
        file.write_metadata("scenes", {0: "green", 1: "red"}, 0.5e-6, 0.5e-6, 2e-6)
    with pytest.raises(DatasetError, match="2 channels: green, red"):
        import_dataset(path, tmp_path / "a.wafer")
    data = import_dataset(path, tmp_path / "a.wafer", channel="red")
    assert [(field.row, field.col) for field in data.fields] == [(0, 0), (0, 1)]
    assert data.fields[1].x_um - data.fields[0].x_um == pytest.approx(0.5 * (COLS - 8))
    np.testing.assert_array_equal(data.stack(2).images, images("czi") + 11)


def test_images_of_a_zarr_collection_are_fields_in_their_places(tmp_path):
    import zarr

    root = zarr.open_group(str(tmp_path / "a.zarr"), mode="w", zarr_format=2)
    root.attrs["bioformats2raw.layout"] = 3
    for n, (x, y) in enumerate(((0, 0), (30, 0), (0, 22))):
        one = root.create_group(str(n))
        one.create_array("0", data=images("zarr_04") + np.uint16(n), chunks=(1, 48, 64))
        axes = [{"name": name, "type": "space", "unit": "micrometer"} for name in "zyx"]
        changes = [{"type": "scale", "scale": [2, 0.5, 0.5]}, {"type": "translation", "translation": [0, y, x]}]
        datasets = [{"path": "0", "coordinateTransformations": changes}]
        one.attrs["multiscales"] = [{"axes": axes, "datasets": datasets, "version": "0.4"}]
    data = import_dataset(tmp_path / "a.zarr", tmp_path / "a.wafer")
    assert [(field.row, field.col) for field in data.fields] == [(0, 0), (0, 1), (1, 0)]
    np.testing.assert_array_equal(data.stack(3).images, images("zarr_04") + 2)
    zarr.open_group(str(tmp_path / "b.zarr"), mode="w")
    with pytest.raises(DatasetError, match="without OME images"):
        open_stack(tmp_path / "b.zarr")


def test_frames_of_a_video_are_read_in_any_order_and_dropped_ones_leave_gaps(tmp_path):
    path = video(tmp_path, np.repeat(images("video"), 20, 0), "")
    planes = planes_of(path)
    for n in (100, 3, 4, 119, 0):
        np.testing.assert_array_equal(planes[n].read(), images("video")[n // 20])
    assert _numbers_of_frames([0, 33, 66, 133, 167]) == ([0, 1, 2, 4, 5], 1)
    assert _numbers_of_frames([0, 30, 75, 90]) == ([0, 1, 2, 3], 0)


OPTICS = {
    "volume": SimpleNamespace(
        axesCalibration=(PIXEL_UM, PIXEL_UM, STEP_UM),
        axesCalibrated=(True, True, True),
        pixelToStageTransformationMatrix=(-PIXEL_UM, 0, 0, 0, PIXEL_UM, 0),
    ),
    "microscope": SimpleNamespace(objectiveNumericalAperture=0.45, objectiveName="Plan 20x"),
}
CHANNELS = [SimpleNamespace(channel=SimpleNamespace(name=name), **OPTICS) for name in ("BF", "FL")]


class StandInForNd2(ModuleType):
    """The nd2 library with a file of two positions and two channels, whose stage turns the image by half."""

    def __init__(self, *, piezo: bool) -> None:
        super().__init__("nd2")
        self.piezo = piezo

    def ND2File(self, _):  # noqa: N802 - a name of nd2
        return self

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    sizes = {"P": 2, "Z": N, "C": 2, "Y": ROWS, "X": COLS}  # noqa: RUF012
    loop_indices = tuple({"P": p, "Z": z} for p in range(2) for z in range(N))
    text_info = {"description": "SIMULATED. Stack"}  # noqa: RUF012
    experiment = (
        SimpleNamespace(type="ZStackLoop", parameters=SimpleNamespace(stepUm=STEP_UM, bottomToTop=False, count=N)),
    )
    metadata = SimpleNamespace(channels=CHANNELS)

    def events(self):
        return [{"Exposure Time [ms]": np.float64(EXPOSURE_MS)}] * (2 * N)

    def frame_metadata(self, n):
        p, z = divmod(n, N)
        at = SimpleNamespace(x=1000 - 40.0 * p, y=500.0, z=900 - (0 if self.piezo else STEP_UM * z))
        time = SimpleNamespace(relativeTimeMs=100.0 * n, absoluteJulianDayNumber=2460436.5)
        return SimpleNamespace(channels=[SimpleNamespace(position=SimpleNamespace(stagePositionUm=at), time=time)])

    def read_frame(self, n):
        p, z = divmod(n, N)
        return np.stack([images("nd2")[z] + np.uint16(p), images("nd2")[z] + np.uint16(2 + p)])


@pytest.mark.parametrize("piezo", [True, False])
def test_words_of_an_nd2_file(tmp_path, monkeypatch, piezo):
    monkeypatch.setitem(sys.modules, "nd2", StandInForNd2(piezo=piezo))
    (tmp_path / "a.nd2").touch()
    data = import_dataset(tmp_path / "a.nd2", tmp_path / "a.wafer", channel="FL")
    assert data.simulated
    assert data.scan.setup.objective == "Plan 20x NA 0.45"
    assert data.scan.imported_from.endswith("taken 2024-05-06T00:00:00Z")
    assert data.fields[1].x_um - data.fields[0].x_um == pytest.approx(40), "the stage goes the other way"
    stack = data.stack(2)
    np.testing.assert_array_equal(stack.images, (images("nd2") + 3)[::-1])
    np.testing.assert_allclose(stack.z_um - stack.z_um[0], STEP_UM * np.arange(N))
    assert stack.exposure_us == 1e3 * EXPOSURE_MS
