"""A scan with damaged frames is continued: exactly these are taken again, and all others stay as they are."""

from __future__ import annotations

import numpy as np
import pytest
import tifffile

from tests.support.datasets.samples import COLS, ROWS, SUMMARY, all_shots, make_frame, make_job, make_plan
from wafer_viewer.model.acquisition.plan import Shot
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.dataset.dataset import Dataset, check_passes
from wafer_viewer.store.dataset.frame_lines import JournalIndex
from wafer_viewer.store.dataset.scan_record import JOURNAL
from wafer_viewer.store.dataset.writer import DatasetWriter

N_FRAMES = 6


def take(writer):
    """Take the passes of a plan; frames that count are not written again."""
    n_written = 0
    for number, leg in enumerate(writer.record.plan.legs):
        writer.pass_begun(number, leg)
        for shot in leg.shots:
            n_written += shot not in writer.kept
            writer.frame(make_frame(shot, writer.record.plan))
        writer.pass_ended(number, SUMMARY)
    writer.finish()
    return n_written


@pytest.fixture
def scan(tmp_path):
    job = make_job(n_frames=N_FRAMES)
    with DatasetWriter.create(tmp_path / "a.wafer", make_plan(job), job) as writer:
        take(writer)
    return tmp_path / "a.wafer"


def harm_frame(path, shot):
    data = Dataset.open(path)
    images = data.stack(shot.field, verify=False).images
    harm(path / "frames" / f"{data.field(shot.field).name}.tif", images.offset + shot.k * ROWS * COLS + 7)


def harm(file, at):
    content = bytearray(file.read_bytes())
    content[at] ^= 16
    file.write_bytes(content)


def continued(path):
    with DatasetWriter.resume(path) as writer:
        kept = writer.kept
        return kept, take(writer)


def test_damaged_frames_of_a_complete_scan_are_taken_again(scan):
    before = [np.array(Dataset.open(scan).stack(n).images) for n in (1, 2)]
    for shot in (Shot(1, 2), Shot(2, 0), Shot(2, 5)):
        harm_frame(scan, shot)
    assert Dataset.open(scan).check().damaged == (Shot(1, 2), Shot(2, 0), Shot(2, 5))
    every = set(all_shots(Dataset.open(scan).scan.plan))
    kept, n_written = continued(scan)
    assert kept == every - {Shot(1, 2), Shot(2, 0), Shot(2, 5)}
    assert n_written == 3
    data = Dataset.open(scan)
    assert data.check().ok
    assert data.kept() == every
    assert check_passes(data).ok
    assert [f for f in data.faults if "3 frames were damaged, of fields 1, 2: they are taken again" in f]
    for images, n in zip(before, (1, 2), strict=True):
        np.testing.assert_array_equal(data.stack(n).images, images)


def test_slots_of_damaged_frames_are_missing_until_they_are_taken(scan):
    harm_frame(scan, Shot(2, 3))
    assert Dataset.open(scan).finished
    DatasetWriter.resume(scan).close()
    data = Dataset.open(scan)
    assert data.missing() == {Shot(2, 3)}
    assert data.missed() == {Shot(2, 3): "its frame was damaged on the disk"}
    assert not data.finished
    assert data.complete_fields() == {1}
    assert not data.stack(2).present[3]
    table = data._frames.table()
    others = tuple(data._others)
    JournalIndex((scan / JOURNAL).stat().st_size, data._journal.n_lines, data._ended, others, table).write(
        scan / JOURNAL
    )
    assert Dataset.open(scan).missing() == {Shot(2, 3)}, "the index of a long journal knows, too"


@pytest.mark.parametrize("harmed", ["deleted", "no TIFF file", "cut off", "compressed"])
def test_a_file_that_cannot_be_read_is_made_and_taken_again(scan, harmed):
    file = scan / "frames" / "r0000c0001.tif"
    if harmed == "deleted":
        file.unlink()
    elif harmed == "no TIFF file":
        file.write_bytes(b"rubbish")
    elif harmed == "cut off":
        file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    else:
        Dataset.open(scan).compress("zstd")
        with tifffile.TiffFile(file) as opened:
            (at,) = opened.pages[3].dataoffsets
        harm(file, at)  # the mark of zstd
    assert not Dataset.open(scan).check().ok
    kept, n_written = continued(scan)
    assert {shot.field for shot in kept} == {1}
    assert n_written == N_FRAMES
    assert Dataset.open(scan).check().ok


def test_damaged_tags_are_written_again_and_no_frame_is_taken(scan):
    harm(scan / "frames" / "r0000c0000.tif", 400)
    assert "checksum of its tags differs" in Dataset.open(scan).check().faults[0]
    kept, n_written = continued(scan)
    assert (len(kept), n_written) == (2 * N_FRAMES, 0)
    assert Dataset.open(scan).check().ok


def test_a_frame_and_the_tags_of_its_file_are_mended_together(scan):
    harm_frame(scan, Shot(1, 1))
    harm(scan / "frames" / "r0000c0000.tif", 400)
    assert continued(scan)[1] == 1
    assert Dataset.open(scan).check().ok


def test_the_sentence_names_how_to_go_on(scan):
    harm_frame(scan, Shot(1, 2))
    with pytest.raises(DatasetError, match=r"continue the scan, .* \(wafer-viewer scan PLAN.toml -o a.wafer\)\.$"):
        Dataset.open(scan).stack(1)


def test_frames_of_imported_images_are_imported_again(tmp_path):
    job = make_job(n_frames=N_FRAMES)
    with DatasetWriter.create(tmp_path / "a.wafer", make_plan(job), job, imported_from="images") as writer:
        take(writer)
    (tmp_path / "a.wafer" / "frames" / "r0000c0000.tif").unlink()
    with pytest.raises(DatasetError, match=r"is missing: restore it from a copy, or import its images again\.$"):
        Dataset.open(tmp_path / "a.wafer").stack(1)
