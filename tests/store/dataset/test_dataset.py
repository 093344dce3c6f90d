from __future__ import annotations

import os
import subprocess
import sys
import time

import msgspec
import numpy as np
import pytest
import tifffile
from PIL import Image as PillowImage

from tests.bench import bench_index
from tests.support.datasets.samples import (
    CALIBRATION,
    COLS,
    ROWS,
    SUMMARY,
    all_shots,
    make_frame,
    make_image,
    make_job,
    make_plan,
)
from wafer_viewer.model.acquisition.focus_stack import FrameStatus
from wafer_viewer.model.acquisition.plan import Shot
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.dataset import frame_pages, scan_record
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.lock import holder_of
from wafer_viewer.store.dataset.writer import DatasetWriter


def scanned(path, shots=None, *, job=None, **about):
    """A dataset with the frames of some slots (all of them when none are named), closed again."""
    job = job or make_job()
    plan = make_plan(job)
    with DatasetWriter.create(path, plan, job, **about) as writer:
        for shot in all_shots(plan) if shots is None else shots:
            writer.frame(make_frame(shot, plan))
    return Dataset.open(path)


def test_what_was_scanned_is_what_is_read(tmp_path):
    data = scanned(tmp_path / "a.wafer", rig="bench", simulated=True)
    stack = data.stack(2)
    np.testing.assert_array_equal(stack.images, [make_image(Shot(2, k)) for k in range(4)])
    np.testing.assert_allclose(stack.z_um, -10 + 2 * np.arange(4) + 0.05)
    assert stack.present.all()
    assert stack.simulated
    assert not stack.images.flags.writeable
    assert data.name == "a"
    assert data.scan.rig == "bench"
    assert data.complete_fields() == {1, 2}
    assert data.finished
    assert data.check().ok


def test_a_partly_scanned_field_says_which_frames_it_has(tmp_path):
    data = scanned(tmp_path / "a.wafer", [Shot(1, 0), Shot(1, 2), Shot(1, 3), Shot(2, 1)])
    assert data.stack(1).present.tolist() == [True, False, True, True]
    assert data.stack(1).z_um[1] == -8.0
    assert data.missing() == {Shot(1, 1), Shot(2, 0), Shot(2, 2), Shot(2, 3)}
    assert data.complete_fields() == set()
    assert not data.finished
    with pytest.raises(DatasetError, match=r"Field 2 of a.wafer has 1 of 4 frames and at least 3"):
        data.stack(2)


def test_exposures_are_stacks_of_their_own(tmp_path):
    data = scanned(tmp_path / "a.wafer", job=make_job(exposures=2))
    for exposure in (0, 1):
        expected = [make_image(Shot(1, k, exposure)) for k in range(4)]
        np.testing.assert_array_equal(data.stack(1, exposure).images, expected)
        assert data.stack(1, exposure).brackets == ()
    with pytest.raises(DatasetError, match=r"2 exposures at each z and no number 2"):
        data.stack(1, 2)


def test_a_stack_holds_all_exposures_unless_one_is_requested(tmp_path):
    data = scanned(tmp_path / "a.wafer", job=make_job(exposures=2))
    stack = data.stack(1)
    assert [one.exposure_us for one in stack.exposures] == [100.0, 200.0]
    for exposure, one in enumerate(stack.exposures):
        np.testing.assert_array_equal(one.images, [make_image(Shot(1, k, exposure)) for k in range(4)])
        assert not one.images.flags.writeable
        assert one.present.all()
    assert stack.checksum not in {data.stack(1, 0).checksum, data.stack(1, 1).checksum}
    np.testing.assert_array_equal(
        tifffile.imread(tmp_path / "a.wafer/frames/r0000c0000.tif", key=3), make_image(Shot(1, 1, 1))
    )


def test_other_programs_open_the_frames(tmp_path):
    scanned(tmp_path / "a.wafer")
    path = tmp_path / "a.wafer/frames/r0000c0001.tif"
    with tifffile.TiffFile(path) as file:
        assert len(file.pages) == 4
        assert file.pages.first.get_resolution("MICROMETER")[0] == pytest.approx(2.0)
        assert file.series[0].axes == "ZYX"
        np.testing.assert_array_equal(file.pages[2].asarray(), make_image(Shot(2, 2)))
    with PillowImage.open(path) as image:
        image.seek(3)
        np.testing.assert_array_equal(np.asarray(image), make_image(Shot(2, 3)))


def test_the_disk_space_is_claimed_before_the_scan(tmp_path):
    job = make_job(n_frames=20)
    plan = make_plan(job, rows=200, cols=300)
    with DatasetWriter.create(tmp_path / "a.wafer", plan, job):
        claimed = (tmp_path / "a.wafer/frames/r0000c0000.tif").stat().st_blocks * 512
    assert claimed >= 20 * 200 * 300


def test_large_fields_become_big_tiffs(tmp_path):
    shape = frame_pages.PageShape(n_pages=3000, rows=1080, cols=1440, bits=8)
    tifffile.imwrite(
        tmp_path / "sparse.tif", shape=(shape.n_pages, shape.rows, shape.cols), dtype=shape.dtype, metadata=None
    )
    image = make_image(Shot(1, 1), 1080, 1440)
    frame_pages.PageWriter(tmp_path / "sparse.tif", shape).write(2999, image)
    with tifffile.TiffFile(tmp_path / "sparse.tif") as file:
        assert file.is_bigtiff
    np.testing.assert_array_equal(frame_pages.map_pages(tmp_path / "sparse.tif", shape)[2999], image)


def test_sixteen_bits_are_kept(tmp_path):
    job = make_job(cols=1, n_frames=3)
    plan = make_plan(job)
    with DatasetWriter.create(tmp_path / "a.wafer", plan, job, bits=12) as writer:
        for shot in all_shots(plan):
            writer.frame(make_frame(shot, plan, make_image(shot, dtype=np.uint16)))
    stack = Dataset.open(tmp_path / "a.wafer").stack(1)
    assert stack.images.dtype == np.uint16
    np.testing.assert_array_equal(stack.images[1], make_image(Shot(1, 1), dtype=np.uint16))


def test_a_stopped_scan_continues_where_it_was(tmp_path):
    done = []
    plan = make_plan(make_job())
    scanned(tmp_path / "a.wafer", all_shots(plan)[:3])
    with DatasetWriter.resume(tmp_path / "a.wafer", on_field_complete=done.append) as writer:
        assert writer.kept == set(all_shots(plan)[:3])
        for shot in all_shots(plan)[2:]:
            writer.frame(make_frame(shot, plan))
    assert done == [1, 2]
    assert Dataset.open(tmp_path / "a.wafer").check().ok


def test_a_page_that_is_kept_is_not_written_again(tmp_path):
    plan = make_plan(make_job())
    scanned(tmp_path / "a.wafer")
    with DatasetWriter.resume(tmp_path / "a.wafer") as writer:
        writer.frame(make_frame(Shot(1, 0), plan, np.zeros((ROWS, COLS), np.uint8)))
    np.testing.assert_array_equal(Dataset.open(tmp_path / "a.wafer").stack(1).images[0], make_image(Shot(1, 0)))


@pytest.mark.parametrize("cut", [1, 7, 40])
def test_a_line_torn_by_a_power_cut_costs_one_frame(tmp_path, cut):
    plan = make_plan(make_job())
    scanned(tmp_path / "a.wafer")
    journal = tmp_path / "a.wafer/journal.jsonl"
    journal.write_bytes(journal.read_bytes()[:-cut])
    last = all_shots(plan)[-1]
    assert Dataset.open(tmp_path / "a.wafer").missing() == {last}
    with DatasetWriter.resume(tmp_path / "a.wafer") as writer:
        writer.frame(make_frame(last, plan))
    assert Dataset.open(tmp_path / "a.wafer").check().ok


def test_a_last_line_of_zeros_is_ignored_and_cut_off(tmp_path):
    plan = make_plan(make_job())
    scanned(tmp_path / "a.wafer", all_shots(plan)[:-1])
    with (tmp_path / "a.wafer/journal.jsonl").open("ab") as file:
        file.write(b"\0" * 30 + b"\n")
    assert len(Dataset.open(tmp_path / "a.wafer").kept()) == 7
    with DatasetWriter.resume(tmp_path / "a.wafer") as writer:
        writer.frame(make_frame(all_shots(plan)[-1], plan))
    assert Dataset.open(tmp_path / "a.wafer").finished


def test_damage_in_the_middle_of_the_journal_is_named(tmp_path):
    scanned(tmp_path / "a.wafer")
    journal = tmp_path / "a.wafer/journal.jsonl"
    lines = journal.read_bytes().split(b"\n")
    lines[2] = lines[2][:-5]
    journal.write_bytes(b"\n".join(lines))
    with pytest.raises(DatasetError, match=r"journal.jsonl is damaged in line 3"):
        Dataset.open(tmp_path / "a.wafer")


def test_the_journal_tells_the_story_in_typed_lines(tmp_path):
    job = make_job()
    plan = make_plan(job)
    with DatasetWriter.create(tmp_path / "a.wafer", plan, job) as writer:
        writer.pass_begun(0, plan.legs[0])
        writer.frame(make_frame(Shot(1, 0), plan))
        writer.missed(Shot(1, 1), 1, "the camera gave no image")
        writer.frame(make_frame(Shot(1, 2), plan, status=FrameStatus.INCOMPLETE))
        writer.pass_ended(0, SUMMARY)
        writer.frame(make_frame(Shot(1, 1), plan))
        writer.repaired(Shot(1, 1))
        writer.fault("the light went out")
        writer.finish()
    lines = [msgspec.json.decode(line) for line in (tmp_path / "a.wafer/journal.jsonl").read_bytes().splitlines()]
    assert [line["type"] for line in lines] == [
        *("pass_begun", "frame", "missed", "missed", "pass_ended", "frame", "repaired", "fault", "finished")
    ]
    data = Dataset.open(tmp_path / "a.wafer")
    assert data.missed() == {Shot(1, 2): "the image was incomplete"}
    assert data.faults == ("the light went out",)
    assert data.finished
    assert Shot(2, 0) in data.missing()


def test_a_reader_follows_a_scan(tmp_path):
    job = make_job()
    plan = make_plan(job)
    with DatasetWriter.create(tmp_path / "a.wafer", plan, job) as writer:
        data = Dataset.open(tmp_path / "a.wafer")
        assert not data.kept()
        for n, shot in enumerate(all_shots(plan), 1):
            writer.frame(make_frame(shot, plan))
            data.refresh()
            assert len(data.kept()) == n
    assert data.complete_fields() == {1, 2}


def test_a_changed_page_and_a_lost_file_are_found(tmp_path):
    data = scanned(tmp_path / "a.wafer")
    page = data.stack(1).images
    with (tmp_path / "a.wafer/frames/r0000c0000.tif").open("r+b") as file:
        file.seek(page.offset + ROWS * COLS)
        file.write(b"\xff\x00\xff")
    (tmp_path / "a.wafer/frames/r0000c0001.tif").unlink()
    fractions = []
    report = data.check(fractions.append)
    assert report.damaged == (Shot(1, 1),)
    assert report.n_good == 3
    assert len(report.faults) == 1
    assert "r0000c0001.tif is missing" in report.faults[0]
    assert not report.ok
    assert fractions == sorted(fractions)
    assert fractions[-2:] == [0.75, 1.0], "the fields are the second half of the work"


def test_the_checksum_of_a_stack_follows_its_frames(tmp_path):
    a, b = scanned(tmp_path / "a.wafer"), scanned(tmp_path / "b.wafer")
    assert a.stack(1).checksum == b.stack(1).checksum
    assert a.stack(1).checksum != a.stack(2).checksum


def test_lengths_come_out_calibrated(tmp_path):
    data = scanned(tmp_path / "a.wafer", calibration=CALIBRATION)
    np.testing.assert_allclose(data.stack(1).z_um, 1.01 * (-10 + 2 * np.arange(4) + 0.05))
    assert data.stack(1).pixel_um == 0.5
    assert data.stack(1).calibration == CALIBRATION
    assert data.calibration_problem("2026-06-01") is None
    assert "due on 2027-01-01" in data.calibration_problem("2027-01-02")
    assert "no calibration" in scanned(tmp_path / "b.wafer").calibration_problem("2026-06-01")


def test_one_writer_at_a_time(tmp_path):
    job = make_job()
    with DatasetWriter.create(tmp_path / "a.wafer", make_plan(job), job):
        assert holder_of(tmp_path / "a.wafer").pid == os.getpid()
        with pytest.raises(DatasetError, match=rf"a.wafer is being written by process {os.getpid()} on "):
            DatasetWriter.resume(tmp_path / "a.wafer")
        Dataset.open(tmp_path / "a.wafer")
    assert holder_of(tmp_path / "a.wafer") is None
    DatasetWriter.resume(tmp_path / "a.wafer").close()


def test_the_lock_of_a_killed_process_is_taken_over(tmp_path):
    scanned(tmp_path / "a.wafer")
    code = "import os, sys; from pathlib import Path; from wafer_viewer.store.dataset.lock import Lock; "
    code += "Lock.take(Path(sys.argv[1])); os.kill(os.getpid(), 9)"
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "a.wafer")], check=False)
    assert b"pid" in (tmp_path / "a.wafer/lock").read_bytes()
    assert holder_of(tmp_path / "a.wafer") is None
    DatasetWriter.resume(tmp_path / "a.wafer").close()


def test_a_holder_on_another_machine_is_believed(tmp_path):
    scanned(tmp_path / "a.wafer")
    (tmp_path / "a.wafer/lock").write_text('{"pid": 1, "host": "far-away", "since": "today"}')
    assert holder_of(tmp_path / "a.wafer").host == "far-away"
    with pytest.raises(DatasetError, match=r"process 1 on far-away.*delete the file"):
        DatasetWriter.resume(tmp_path / "a.wafer")


def test_a_dataset_is_not_written_over(tmp_path):
    scanned(tmp_path / "a.wafer")
    with pytest.raises(DatasetError, match="exists already"):
        scanned(tmp_path / "a.wafer")
    assert Dataset.open(tmp_path / "a.wafer").finished


@pytest.mark.parametrize(
    ("place", "mend"),
    [("a_file/x.wafer", "a part of the path is a file"), ("nowhere/x.wafer", "its folder does not exist")],
)
def test_a_place_that_cannot_be_written_to(tmp_path, place, mend):
    (tmp_path / "a_file").write_text("here")
    with pytest.raises(DatasetError, match=mend):
        scanned(tmp_path / place)
    assert [p.name for p in tmp_path.iterdir()] == ["a_file"]


def test_a_scan_larger_than_the_disk_is_refused_before_it_starts(tmp_path):
    job = make_job()
    plan = make_plan(job, rows=10_000_000, cols=10_000_000)
    with pytest.raises(DatasetError, match=r"a.wafer needs \d+\.\d GB and .* has .* free"):
        DatasetWriter.create(tmp_path / "a.wafer", msgspec.structs.replace(plan, legs=()), job)
    assert not (tmp_path / "a.wafer").exists()


def test_a_frame_that_the_plan_does_not_know(tmp_path):
    job = make_job()
    plan = make_plan(job)
    with DatasetWriter.create(tmp_path / "a.wafer", plan, job) as writer:
        with pytest.raises(DatasetError, match="not in the plan"):
            writer.frame(make_frame(Shot(1, 9), plan))
        with pytest.raises(DatasetError, match=r"is 5 x 6 px of uint8.*holds 8 x 6 px"):
            writer.frame(make_frame(Shot(1, 0), plan, np.zeros((6, 5), np.uint8)))


@pytest.mark.parametrize(
    ("harm", "sentence"),
    [
        (lambda d: (d / "scan.json").unlink(), "is not a dataset, it has no scan.json"),
        (lambda d: (d / "scan.json").write_text("{"), "scan.json: "),
        (lambda d: (d / "scan.json").write_text('{"schema_version": 99}'), "has format 99 .* newer Wafer Viewer"),
        (lambda d: (d / "journal.jsonl").unlink(), "journal.jsonl cannot be read"),
        (lambda d: [p.unlink() for p in (d / "frames").iterdir()], "r0000c0000.tif is missing"),
        (lambda d: (d / "frames/r0000c0000.tif").write_text("x"), "cannot be read as a TIFF file"),
        (lambda d: os.truncate(d / "frames/r0000c0000.tif", 400), "r0000c0000.tif (does not hold 4|cannot be read)"),
    ],
)
def test_what_can_be_wrong_with_a_dataset_is_one_sentence(tmp_path, harm, sentence):
    scanned(tmp_path / "a.wafer")
    harm(tmp_path / "a.wafer")
    with pytest.raises(DatasetError, match=sentence) as caught:
        Dataset.open(tmp_path / "a.wafer").stack(1)
    assert "\n" not in str(caught.value)


def test_a_path_that_is_not_there():
    with pytest.raises(DatasetError, match="does not exist: check the path"):
        Dataset.open("/nowhere/at/all.wafer")


def test_a_large_record_is_read_once_until_it_changes(tmp_path, monkeypatch):
    monkeypatch.setattr(scan_record, "_LARGE_BYTES", 1)
    path = scanned(tmp_path / "a.wafer").path
    record = Dataset.open(path).scan
    assert Dataset.open(path).scan is record
    other = msgspec.structs.replace(record, rig="another rig")
    scan_record.write_record(path, other)
    assert Dataset.open(path).scan == other
    (path / scan_record.RECORD).unlink()
    with pytest.raises(DatasetError, match="is not a dataset"):
        Dataset.open(path)


@pytest.mark.campaign
def test_a_journal_of_very_many_passes_opens_in_time_proportional_to_it(tmp_path):
    path = bench_index.make(tmp_path / "many.wafer", 20_000, 3)
    began = time.process_time()
    data = Dataset.open(path)
    assert time.process_time() - began < 8, "copying the frames at the end of each pass took ten times as long"
    assert data.complete_fields() == {field.number for field in data.fields}
    assert data.field(data.fields[-1].number) is data.fields[-1]
    assert data.finished
    assert len(data.kept()) == 3 * len(data.fields)
    assert data.result().surfaces_done(data.fields) == set()
