"""Frames that need less room: the same frames, whatever happens while they are compressed."""

from __future__ import annotations

import errno
import random
import shutil
import signal
import subprocess
import sys

import numpy as np
import pytest
import tifffile

import wafer_viewer as wv
from tests.support.datasets.samples import SUMMARY, make_frame, make_job, make_plan
from wafer_viewer.model.acquisition.plan import Shot
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.dataset import frame_pages
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.frame_pages import compression_of
from wafer_viewer.store.dataset.integrity import digests_of_scan
from wafer_viewer.store.dataset.scan_record import frames_file
from wafer_viewer.store.dataset.writer import DatasetWriter
from wafer_viewer.store.io import format_version
from wafer_viewer.store.io.checksums import file_mark
from wafer_viewer.store.io.format_version import SCHEMA

ROWS, COLS, N_FRAMES, N_FIELDS = 90, 120, 20, 4
HOLE = Shot(2, 3)
CODECS = ("zstd", "deflate", "jpeg2000")


def smooth_image(shot, dtype):
    """A texture that is sharpest in the middle of the stack, with little noise."""
    rows, cols = np.mgrid[:ROWS, :COLS]
    sharp = 40 * np.exp(-(((shot.k - N_FRAMES / 2) / 4) ** 2))
    grey = 120 + sharp * np.sin(rows / 2 + shot.field) * np.cos(cols / 3)
    noise = np.random.default_rng([shot.field, shot.k]).integers(0, 3, (ROWS, COLS))
    return ((grey + noise) * (1 if dtype == np.uint8 else 16)).astype(dtype)


def make_dataset(path, dtype=np.uint8, without=(HOLE,)):
    job = make_job(cols=N_FIELDS, n_frames=N_FRAMES)
    plan = make_plan(job, ROWS, COLS)
    with DatasetWriter.create(path, plan, job, bits=8 * np.dtype(dtype).itemsize) as writer:
        for number, leg in enumerate(plan.legs):
            writer.pass_begun(number, leg)
            for shot in leg.shots:
                writer.frame(make_frame(shot, plan, smooth_image(shot, dtype)))
                if shot in without:
                    writer.missed(shot, shot.k, "it was blurred")
            writer.pass_ended(number, SUMMARY)
    return Dataset.open(path)


@pytest.fixture(scope="module")
def original(tmp_path_factory):
    return make_dataset(tmp_path_factory.mktemp("original") / "a.wafer")


@pytest.fixture
def data(original, tmp_path):
    return Dataset.open(shutil.copytree(original.path, tmp_path / "a.wafer"))


def codecs_of(data):
    return [compression_of(frames_file(data.path, field), data.scan.pages(field)) for field in data.fields]


def assert_same_frames(path, original):
    """Everything that the two datasets hold is the same, and nothing of it is damaged."""
    data = Dataset.open(path)
    report = data.check()
    assert (report.damaged, report.faults) == ((), ())
    assert not any(kind.damaged for kind in report.files)
    for field in original.fields:
        ours, theirs = data.stack(field.number), original.stack(field.number)
        np.testing.assert_array_equal(ours.images[ours.present], theirs.images[theirs.present])
        np.testing.assert_array_equal(ours.present, theirs.present)
        assert (ours.z_um.tolist(), ours.checksum) == (theirs.z_um.tolist(), theirs.checksum)
    assert digests_of_scan(path) == digests_of_scan(original.path)


@pytest.mark.parametrize("codec", CODECS)
def test_compressed_frames_are_the_same_and_smaller(codec, data, original):
    report = data.compress(codec)
    assert codecs_of(data) == [codec] * N_FIELDS
    assert report.n_changed == N_FIELDS
    assert report.bytes_after == data.frame_bytes() < 0.7 * report.bytes_before
    assert_same_frames(data.path, original)
    assert not Dataset.open(data.path).stack(1).images.flags.writeable
    path = frames_file(data.path, data.field(2))
    with tifffile.TiffFile(path) as file:
        assert (file.series[0].kind, file.series[0].shape) == ("ome", (N_FRAMES, ROWS, COLS))
        assert [k for k, page in enumerate(file.series[0].pages) if page is None] == [HOLE.k]
        np.testing.assert_array_equal(file.series[0].asarray()[7], smooth_image(Shot(2, 7), np.uint8))
    assert not tifffile.imread(path, key=HOLE.k).any(), "a rejected frame is not stored"


def test_sixteen_bits_are_compressed_and_decompressed(tmp_path):
    data = make_dataset(tmp_path / "a.wafer", np.uint16)
    other = Dataset.open(shutil.copytree(data.path, tmp_path / "b.wafer"))
    other.compress("zstd")
    assert_same_frames(other.path, data)
    other.compress("none")
    assert_same_frames(other.path, data)


def test_heights_are_the_same_to_the_bit(data, original):
    data.compress()
    recipe = wv.Recipe(window=5)
    ours, theirs = (wv.reconstruct(one.stack(1), recipe) for one in (Dataset.open(data.path), original))
    np.testing.assert_array_equal(ours.z_um, theirs.z_um)
    assert np.isfinite(ours.z_um).any()


def test_decompressed_files_are_those_of_a_scan(data, original):
    record = (data.path / "scan.json").read_bytes()
    data.compress("zstd")
    assert (data.path / "scan.json").read_bytes() != record
    data.compress("none")
    assert (data.path / "scan.json").read_bytes() == record
    assert codecs_of(data) == ["none"] * N_FIELDS
    assert frames_file(data.path, data.field(1)).read_bytes() == frames_file(original.path, data.field(1)).read_bytes()


def test_what_is_compressed_is_left_alone(data):
    data.compress()
    before = [file_mark(frames_file(data.path, field)) for field in data.fields]
    assert data.compress().n_changed == 0
    assert [file_mark(frames_file(data.path, field)) for field in data.fields] == before


def test_older_programs_say_why_they_cannot_open_it(data, monkeypatch):
    data.compress()
    monkeypatch.setattr(format_version, "SCHEMA", 1)
    with pytest.raises(DatasetError, match=rf"has format {2 * SCHEMA} .* 1 to 2: open it with a newer Wafer Viewer"):
        Dataset.open(data.path)


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize("codec", ["zstd", "none"])
@pytest.mark.parametrize("stop_at", [0, 1, 3, 6])
def test_a_stopped_compression_leaves_every_frame_and_continues(codec, stop_at, data, original):
    if codec == "none":
        data.compress("zstd")
    polls = iter(range(100))
    with pytest.raises(DatasetError, match=r"stopped at \d of 4 fields, which stay as they are: start it again"):
        data.compress(codec, should_stop=lambda: next(polls) >= stop_at)
    assert_same_frames(data.path, original)
    assert not list((data.path / "frames").glob(".*"))
    data.compress(codec)
    assert codecs_of(data) == [codec] * N_FIELDS
    assert_same_frames(data.path, original)


def test_progress_reaches_the_end_in_order(data):
    done = []
    data.compress("zstd", done.append)
    assert done == sorted(done)
    assert done[-1] == 1.0


@pytest.mark.slow
@pytest.mark.campaign
def test_a_killed_compression_leaves_a_readable_dataset_at_every_moment(data, original):
    code = "import sys; from wafer_viewer.store.dataset.dataset import Dataset\n"
    code += "for codec in ('zstd', 'none') * 50: Dataset.open(sys.argv[1]).compress(codec, lambda _: print(flush=True))"
    seen = set()
    for seed in range(6):
        with subprocess.Popen([sys.executable, "-c", code, str(data.path)], stdout=subprocess.PIPE) as process:
            for _ in range(random.Random(seed).randrange(1, 100)):
                process.stdout.readline()
            process.send_signal(signal.SIGKILL)
        seen |= set(codecs_of(data))
        assert_same_frames(data.path, original)
    assert seen == {"zstd", "none"}, "it was killed in the middle"
    data.compress()
    assert not list((data.path / "frames").glob(".*")), "what a killed process left is removed"
    assert_same_frames(data.path, original)


def test_a_full_disk_is_named_and_nothing_is_lost(data, original, monkeypatch):
    write, n_written = tifffile.TiffWriter.write, iter(range(100))

    def fills_up(self, *args, **options):
        if next(n_written) >= 3:
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(self, *args, **options)

    monkeypatch.setattr(tifffile.TiffWriter, "write", fills_up)
    with pytest.raises(DatasetError, match=r"r0000c0001.tif cannot be written: the disk is full: free some space"):
        data.compress()
    assert codecs_of(data) == ["zstd", "none", "none", "none"]
    assert_same_frames(data.path, original)


def test_a_new_file_that_reads_back_differently_is_not_taken(data, original, monkeypatch):
    from wafer_viewer.store.dataset import compression

    def writes_wrong(path, parts, *args):
        correct(path, (part ^ np.uint8(1) for part in parts), *args)

    correct = compression.write_compressed
    monkeypatch.setattr(compression, "write_compressed", writes_wrong)
    with pytest.raises(DatasetError, match=r"r0000c0000.tif was not replaced: page 0 of the new file reads back"):
        data.compress()
    assert codecs_of(data) == ["none"] * N_FIELDS
    assert_same_frames(data.path, original)


def test_a_file_with_a_damaged_frame_is_left_as_it_is(data):
    path = frames_file(data.path, data.field(3))
    with path.open("r+b") as file:
        file.seek(path.stat().st_size // 2)
        file.write(b"\x55" * 50)
    content = path.read_bytes()
    (fault,) = data.compress().left
    assert "r0000c0002.tif is left as it is, the checksum of page" in fault
    assert codecs_of(data) == ["zstd", "zstd", "none", "zstd"]
    assert path.read_bytes() == content


@pytest.mark.parametrize("at", [0.3, 0.6, 0.999])
def test_damage_of_a_compressed_file_is_found(at, data):
    data.compress()
    path = frames_file(data.path, data.field(1))
    content = bytearray(path.read_bytes())
    content[int(at * len(content))] ^= 4
    path.write_bytes(content)
    (fault,) = data.check().faults
    assert "r0000c0000.tif is damaged" in fault


def test_a_frame_that_cannot_be_decoded_is_damage(data):
    data.compress("deflate")
    path = frames_file(data.path, data.field(1))
    content = bytearray(path.read_bytes())
    middle = len(content) // 2
    content[middle : middle + 500] = bytes(500)
    path.write_bytes(content)
    with pytest.raises(DatasetError, match=r"r0000c0000.tif is damaged"):
        Dataset.open(data.path).stack(1)


def test_a_compressed_dataset_is_continued(data, original):
    data.compress()
    plan = data.scan.plan
    with DatasetWriter.resume(data.path) as writer:
        assert codecs_of(data) == ["zstd", "none", "zstd", "zstd"], "only the field that lacks a frame is decompressed"
        writer.frame(make_frame(HOLE, plan, smooth_image(HOLE, np.uint8)))
    continued = Dataset.open(data.path)
    assert continued.check().ok
    np.testing.assert_array_equal(continued.stack(2).images[HOLE.k], smooth_image(HOLE, np.uint8))
    assert continued.compress().n_changed == 1
    assert Dataset.open(data.path).check().ok
    assert len(original.missing()) == 1


def test_a_dataset_that_is_being_scanned_is_not_compressed(data):
    with DatasetWriter.resume(data.path), pytest.raises(DatasetError, match="is being written by process"):
        data.compress()


def test_a_file_that_is_replaced_while_it_is_opened_is_read_as_it_is_now(data, original, monkeypatch):
    layout_of, compressed = frame_pages._layout, []

    def layout_before(path, shape):
        layout = layout_of(path, shape)
        if not compressed:
            compressed.append(path)
            Dataset.open(data.path).compress()
        return layout

    monkeypatch.setattr(frame_pages, "_layout", layout_before)
    images = data.stack(1, verify=False).images
    np.testing.assert_array_equal(images, original.stack(1).images)
    assert codecs_of(data) == ["zstd"] * N_FIELDS


def test_a_missing_file_is_left_out_and_named(data):
    frames_file(data.path, data.field(4)).unlink()
    report = data.compress()
    assert report.n_changed == 3
    assert "r0000c0003.tif is missing" in report.left[0]
    shutil.rmtree(data.path / "frames")
    with pytest.raises(DatasetError, match="is a surface without its frames"):
        data.compress()


def test_an_unknown_codec_is_refused(data):
    with pytest.raises(DatasetError, match="no codec 'lzma': choose one of none, zstd, deflate, jpeg2000"):
        data.compress("lzma")


def test_another_field_is_decoded_anew(data):
    data.compress()
    again = Dataset.open(data.path)
    first = again.stack(1).images
    assert again.stack(1, verify=False).images.base is first.base
    assert not np.array_equal(again.stack(3).images, first)
    np.testing.assert_array_equal(again.stack(1).images, first)
