"""The frames of a dataset as other programs see them: tifffile, ome-types and the OME schema."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import tifffile
from hypothesis import given
from hypothesis import strategies as st

from tests.support.datasets.samples import CALIBRATION, all_shots, make_frame, make_image, make_job, make_plan
from tests.support.datasets.unsigned import without_manifests
from wafer_viewer.model.acquisition.calibration import OpticalSetup
from wafer_viewer.model.acquisition.plan import UNKNOWN_EXPOSURE_US, Shot
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.frame_pages import tags_crc32c
from wafer_viewer.store.dataset.writer import DatasetWriter
from wafer_viewer.store.io.checksums import closing_bytes, crc32c

MISSING = (Shot(1, 1, 0), Shot(1, 2, 1))
SETUP = OpticalSetup(objective="10x/0.28 µ <&>", camera="camera")
WAFER = "a.wafer"
FIRST = "a.wafer/frames/r0000c0000.tif"


@pytest.fixture
def plan():
    return make_plan(make_job(exposures=2))


def scanned(folder, plan, shots, **about):
    job = make_job(exposures=2)
    with DatasetWriter.create(folder / WAFER, plan, job, setup=SETUP, rig="bench", simulated=True, **about) as writer:
        for shot in shots:
            writer.frame(frame_of(shot, plan))
    return Dataset.open(folder / WAFER)


def frame_of(shot, plan):
    """A frame beside its planned place, 20 ms after the one before it."""
    frame = make_frame(shot, plan)
    return replace(
        frame,
        x_um=frame.x_um + 0.125,
        y_um=frame.y_um - 0.25,
        exposure_us=100.0 * (1 + shot.exposure),
        device_time_us=7_000_000 + 20_000 * (2 * shot.k + shot.exposure),
    )


def ome_of(path):
    import ome_types

    return ome_types.from_xml(tifffile.tiffcomment(path), validate=True)


@pytest.mark.slow
def test_the_header_fits_the_schema_and_tells_where_and_when_each_frame_was_taken(tmp_path, plan):
    scanned(tmp_path, plan, [s for s in all_shots(plan) if s not in MISSING], calibration=CALIBRATION, bits=8)
    ome = ome_of(tmp_path / FIRST)
    image, objective = ome.images[0], ome.instruments[0].objectives[0]
    pixels = image.pixels
    assert (objective.nominal_magnification, objective.lens_na, objective.model) == (10, 0.28, SETUP.objective)
    assert (image.name, image.stage_label.name) == ("r0000c0000", "field 1")
    assert image.description == (
        "SIMULATED. Focus stack of field 1, r0000c0000. 2 of 8 frames are missing: their pages are empty."
    )
    assert (pixels.size_z, pixels.size_c, pixels.size_x, pixels.size_y) == (4, 2, 8, 6)
    assert [pixels.physical_size_x, pixels.physical_size_z] == pytest.approx([0.5, 2.02])
    assert [channel.name for channel in pixels.channels] == ["100 µs", "200 µs"]
    planes = {(p.the_z, p.the_c): p for p in pixels.planes}
    assert (1, 0) not in planes
    assert len(planes) == len(pixels.tiff_data_blocks) == 6
    plane = planes[1, 1]
    assert (plane.position_x, plane.position_y, plane.position_z) == pytest.approx((0.125, -0.25, -7.95))
    assert plane.position_z_unit.value == "µm"
    assert (plane.exposure_time, plane.delta_t) == pytest.approx((200e-6, 0.06))
    value = ome.structured_annotations.map_annotations[0].value
    assert value["simulated"] == "yes"
    assert value["z scale"] == "1.01"


def test_tifffile_reads_axes_and_leaves_out_missing_frames(tmp_path, plan):
    scanned(tmp_path, plan, [s for s in all_shots(plan) if s not in MISSING])
    with tifffile.TiffFile(tmp_path / FIRST) as file:
        series = file.series[0]
        assert (series.kind, series.axes, series.shape) == ("ome", "ZCYX", (4, 2, 6, 8))
        assert [page is None for page in series.pages] == [i in (2, 5) for i in range(8)]
        np.testing.assert_array_equal(series.asarray()[3, 1], make_image(Shot(1, 3, 1)))


def test_a_repaired_frame_is_added_with_its_own_place(tmp_path, plan):
    data = scanned(tmp_path, plan, [s for s in all_shots(plan) if s not in MISSING])
    record = (data.path / "scan.json").read_bytes()
    with DatasetWriter.resume(data.path) as writer:
        late = frame_of(MISSING[0], plan)
        writer.frame(replace(late, z_um=-7.5))
    planes = {(p.the_z, p.the_c): p for p in ome_of(tmp_path / FIRST).images[0].pixels.planes}
    assert len(planes) == 7
    assert planes[1, 0].position_z == -7.5
    assert (data.path / "scan.json").read_bytes() == record
    assert not Dataset.open(data.path).check().faults, "the checksum of the tags is that of the empty file"


def test_a_scan_that_was_killed_has_plain_pages_until_it_is_continued(tmp_path, plan):
    writer = DatasetWriter.create(tmp_path / WAFER, plan, make_job(exposures=2))
    for shot in all_shots(plan):
        writer.frame(frame_of(shot, plan))
    assert json.loads(tifffile.tiffcomment(tmp_path / FIRST))["z_step_um"] == 2.0
    assert Dataset.open(tmp_path / WAFER).check().ok
    np.testing.assert_array_equal(tifffile.imread(tmp_path / FIRST)[5], make_image(Shot(1, 2, 1)))
    writer._lock.release()  # as when the process has gone
    writer.close()
    DatasetWriter.resume(tmp_path / WAFER).close()
    assert len(ome_of(tmp_path / FIRST).images[0].pixels.planes) == 8


def test_a_damaged_header_is_found_and_written_again(tmp_path, plan):
    data = scanned(tmp_path, plan, all_shots(plan))
    before = (tmp_path / FIRST).read_bytes()
    at = before.index(b"PositionX")
    (tmp_path / FIRST).write_bytes(before[:at] + b"\0" * 40 + before[at + 40 :])
    (fault,) = data.check().faults
    assert "the checksum of its tags differs" in fault
    assert "wafer-viewer compress a.wafer --codec none" in fault
    assert data.compress("none").n_changed == 1
    assert data.check().ok
    assert (tmp_path / FIRST).read_bytes() == before
    (tmp_path / FIRST).write_bytes(before[:at] + b"\0" * 40 + before[at + 40 :])
    DatasetWriter.resume(data.path).close()
    assert data.check().ok
    assert (tmp_path / FIRST).read_bytes() == before


def test_files_of_older_versions_stay_as_they_are(tmp_path, plan):
    data = scanned(tmp_path, plan, [])
    pages = data.scan.pages(data.fields[0])
    for field in data.fields:
        path = data.path / "frames" / f"{field.name}.tif"
        shape = (pages.n_pages, pages.rows, pages.cols)
        tifffile.imwrite(path, shape=shape, dtype=pages.dtype, metadata=None, description='{"field": 1}')
    tags = ",\n    ".join(str(tags_crc32c(path, pages)) for path in sorted((data.path / "frames").iterdir()))
    record = json.loads((data.path / "scan.json").read_text())
    record["frame_tag_checksums"] = json.loads(f"[{tags}]")
    del record["crc32c"]
    (data.path / "scan.json").write_text(json.dumps(record))
    without_manifests(data.path)
    with DatasetWriter.resume(data.path) as writer:
        for shot in all_shots(plan):
            writer.frame(frame_of(shot, plan))
    assert tifffile.tiffcomment(tmp_path / FIRST) == '{"field": 1}'
    old = Dataset.open(data.path)
    assert old.check().ok
    stack = old.stack(1)
    old.compress("zstd")
    assert len(ome_of(tmp_path / FIRST).images[0].pixels.planes) == 8
    np.testing.assert_array_equal(Dataset.open(data.path).stack(1).images, stack.images)
    assert Dataset.open(data.path).check().ok


def test_long_names_find_room(tmp_path, plan):
    job = make_job(exposures=2)
    names = {"objective": "µ" * 5000, "camera": "&" * 5000}
    with DatasetWriter.create(
        tmp_path / WAFER, plan, job, setup=OpticalSetup(**names), rig="\U0001f52c" * 5000, imported_from="<" * 5000
    ) as writer:
        for shot in all_shots(plan):
            far = {"x_um": -149_999.123456, "y_um": -149_999.123456, "z_um": -49_999.123456}
            exposure_us = UNKNOWN_EXPOSURE_US if shot.k == 0 else 123_456.789
            writer.frame(replace(frame_of(shot, plan), **far, exposure_us=exposure_us))
    planes = ome_of(tmp_path / FIRST).images[0].pixels.planes
    assert planes[0].exposure_time is None, "images taken elsewhere may have an unknown exposure"
    assert planes[-1].exposure_time == pytest.approx(0.123457)
    assert Dataset.open(tmp_path / WAFER).check().ok


def test_a_header_that_cannot_be_written_costs_no_frame(tmp_path, plan, monkeypatch):
    from wafer_viewer.store.dataset import compression

    def fails(*_):
        raise DatasetError("the disk is gone")

    monkeypatch.setattr(compression, "write_header", fails)
    assert scanned(tmp_path, plan, all_shots(plan)).check().ok


@given(st.binary(max_size=50), st.binary(max_size=50), st.integers(0, 2**32 - 1))
def test_four_bytes_give_any_checksum(before, after, wanted):
    closing = closing_bytes(crc32c(before), after, wanted)
    assert crc32c(before + closing + after) == wanted
