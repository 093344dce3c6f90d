"""Files made to do harm, and damage that once was a traceback: one sentence each, with little memory and time."""

from __future__ import annotations

import io
import os
import struct
import threading
import tracemalloc
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest
import tifffile

from tests.support.datasets.samples import make_job, make_plan, make_surface
from tests.support.fuzzing import feed
from tests.support.outside_readers import OutsideReader
from wafer_viewer.model.errors import DatasetError, PlanError, WaferViewerError
from wafer_viewer.model.job import Job
from wafer_viewer.model.spec import decode
from wafer_viewer.session.planning.job_releases import read_job
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.preview import preview
from wafer_viewer.store.dataset.writer import DatasetWriter
from wafer_viewer.store.formats.conversion import export, read_surface
from wafer_viewer.store.formats.npz_file import read_npz
from wafer_viewer.store.images.image_files import planes_of
from wafer_viewer.store.io.checksums import strip_checksum
from wafer_viewer.store.io.guarded_reading import FACTOR, read_content
from wafer_viewer.store.mosaic.poses_file import read_planes, read_poses
from wafer_viewer.store.records.golden_dies import open_golden

MOST_MB = 100.0
PLAN = "[grid]\nrows = {rows}\ncols = {cols}\nfield_width_um = 10.0\nfield_height_um = 10.0\n" + (
    "[sweep]\nz_step_um = 1.0\nn_frames = 9\n"
)


def refusal(path: Path, read: Callable[[Path], object], most_mb: float = MOST_MB) -> str:
    """The sentence of a refusal that took little time and memory."""
    with pytest.raises(WaferViewerError) as error:
        read(path)
    outcome = feed(OutsideReader(path.name, path, read), path.read_bytes(), most_mb)
    assert not outcome.fault
    return str(error.value)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a = " + "[" * 100_000, "more than 32 levels of brackets"),
        ("a" + ".a" * 50_000 + " = 1", "more than 32 parts"),
        ('"a"' + '."a"' * 30_000 + " = 1", "more than 32 parts"),
        ("a = " + "9" * 5000, "a value cannot be read"),
        ("a = '" + "x" * 100_000, "at end of document"),
        ('"""' + '\\"""' * 30_000, "Expected '='"),
        ("# x\n" * 2_500_000, "more than 8 MB"),
        ("\xff\xfe", "Invalid statement"),
    ],
)
def test_settings_made_to_fill_the_memory_are_refused(tmp_path, text, says):
    path = tmp_path / "plan.toml"
    path.write_text(text)
    assert says in refusal(path, read_job)


def test_deep_texts_between_quotes_are_no_nesting():
    job = decode(f"product = '{'a.' * 100}{'[' * 100}'\n" + PLAN.format(rows=2, cols=3), Job, "plan.toml")
    assert len(job.all_fields()) == 6


@pytest.mark.parametrize(("rows", "cols"), [(100_000, 100_000), (1, 2_000_000), (1001, 1000)])
def test_a_plan_has_at_most_a_million_fields(tmp_path, rows, cols):
    path = tmp_path / "plan.toml"
    path.write_text(PLAN.format(rows=rows, cols=cols))
    assert f"has {rows} rows and {cols} cols: a plan has at most 1000000 fields" in refusal(path, read_job)


def test_a_value_of_any_length_makes_a_short_sentence(tmp_path):
    with pytest.raises(PlanError) as error:
        decode(f"strategy = '{'x' * 100_000}'\ncompression = '{'y' * 100_000}'\n", Job, "plan.toml")
    assert len(str(error.value)) < 600


@pytest.fixture(scope="module")
def bomb() -> bytes:
    """An archive of 300 kB with one array of 300 MB."""
    out = io.BytesIO()
    with (
        zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file,
        file.open("z_um.npy", "w", force_zip64=True) as member,
    ):
        np.lib.format.write_array_header_1_0(member, {"descr": "<f8", "fortran_order": False, "shape": (5000, 7500)})
        for _ in range(30):
            member.write(bytes(10_000_000))
    return out.getvalue()


@pytest.mark.slow
@pytest.mark.parametrize("read", [read_npz, read_planes, read_poses, open_golden, read_surface])
def test_an_archive_that_unpacks_to_far_more_than_its_file_is_refused(tmp_path, read, bomb):
    path = tmp_path / "bomb.golden.npz"
    path.write_bytes(bomb)
    assert "unpacks to 300.0 MB, more than 256.0 MB" in refusal(path, read)


@pytest.mark.slow
def test_the_limits_can_be_raised(tmp_path, monkeypatch, bomb):
    path = tmp_path / "planes.npz"
    path.write_bytes(bomb)
    with pytest.raises(DatasetError, match=f"raise the limits .{FACTOR}"):
        read_planes(path)
    monkeypatch.setenv(FACTOR, "2")
    assert read_planes(path)["z_um"].shape == (5000, 7500)
    monkeypatch.setenv(FACTOR, "many")
    with pytest.raises(DatasetError, match=r"'many': it must be a number between 1 and 1000\.$"):
        read_planes(path)


@pytest.mark.parametrize(
    "header",
    [
        "{'descr': '<f4', 'fortran_order': False, 'shape': (100000000000,), }",
        "{'descr': '<f4', 'fortran_order': False, 'shape': (-1,), }",
        "{'descr': '<f4', 'fortran_order': False, 'shape': (2, ",
        "{'descr': 'O', 'fortran_order': False, 'shape': (2,), }",
        "(" * 500,
        "no header",
    ],
)
@pytest.mark.parametrize("read", [read_npz, read_planes, read_poses, open_golden])
def test_an_array_that_is_none_is_refused(tmp_path, header, read):
    path = tmp_path / "bad.golden.npz"
    body = b"\x93NUMPY\x01\x00" + struct.pack("<H", 1000) + header.ljust(999).encode() + b"\n" + bytes(8)
    with zipfile.ZipFile(path, "w") as file:
        for name in ("z_um", "header", "numbers", "shifts.first"):
            file.writestr(f"{name}.npy", body)
    assert str(path) in refusal(path, read)


@pytest.mark.parametrize("read", [read_npz, read_planes, read_poses, open_golden])
def test_a_member_that_is_no_array_is_refused(tmp_path, read):
    path = tmp_path / "bad.golden.npz"
    with zipfile.ZipFile(path, "w") as file:
        for name in ("z_um", "header", "numbers", "shifts.first"):
            file.writestr(f"{name}.npy", b"text")
    assert str(path) in refusal(path, read)


@pytest.mark.parametrize("sealed", [True, False])
def test_a_flipped_bit_of_a_mapped_height_is_found_when_a_surface_is_opened(tmp_path, sealed):
    path = tmp_path / "surface.npz"
    export(make_surface(), path)
    if not sealed:  # as other programs write it
        with np.load(path) as members:
            arrays = dict(members)
        np.savez(path, **arrays)
    height = struct.pack("<f", read_npz(path).z_um[3, 4])
    content = path.read_bytes()
    at = content.index(height) + 3
    (tmp_path / "flipped.npz").write_bytes(content[:at] + bytes([content[at] ^ 0x40]) + content[at + 1 :])
    with pytest.raises(DatasetError, match="is damaged, its checksum differs"):
        read_npz(tmp_path / "flipped.npz")


def png(rows: int, cols: int) -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    packer = zlib.compressobj(9)
    row = bytes(1 + cols)
    data = b"".join(packer.compress(row) for _ in range(min(rows, 3000))) + packer.flush()
    head = struct.pack(">IIBBBBB", cols, rows, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def test_an_image_of_too_many_pixels_is_refused_and_has_no_preview(tmp_path):
    path = tmp_path / "large.png"
    path.write_bytes(png(30_000, 30_016))
    says = refusal(path, lambda file: [picture.read() for picture in planes_of(file)])
    assert "large.png has 30016 x 30000 pixels, more than 179 million" in says
    assert preview(path) == b""


WEBP_KINDS: dict[str, dict[str, Any]] = {"lossy": {}, "lossless": {"lossless": True}, "extended": {"exif": bytes(8)}}


def webp(kind: str, rows: int, cols: int) -> bytes:
    """Return a WebP of 64 x 48 pixels whose header states others."""
    out = io.BytesIO()
    grey = np.random.default_rng(0).integers(0, 255, (48, 64, 3), dtype=np.uint8)
    PIL.Image.fromarray(grey).save(out, "WEBP", **WEBP_KINDS[kind])
    content = bytearray(out.getvalue())
    if kind == "lossy":
        content[26:30] = struct.pack("<HH", cols, rows)
    elif kind == "lossless":
        kept = int.from_bytes(content[21:25], "little") >> 28
        content[21:25] = (kept << 28 | (rows - 1) << 14 | (cols - 1)).to_bytes(4, "little")
    else:
        content[24:30] = (cols - 1).to_bytes(3, "little") + (rows - 1).to_bytes(3, "little")
    return bytes(content)


@pytest.mark.parametrize("kind", WEBP_KINDS)
def test_a_webp_of_more_pixels_than_it_can_hold_is_refused_before_it_is_decoded(tmp_path, kind):
    path = tmp_path / "large.webp"
    path.write_bytes(webp(kind, 48, 64))
    assert planes_of(path)[0].read().shape == (48, 64)
    path.write_bytes(webp(kind, 9000, 11_000))
    outcome = refusal(path, lambda file: [picture.read() for picture in planes_of(file)])
    assert "large.webp states 11000 x 9000 pixels in" in outcome
    assert preview(path) == b""


def test_an_animation_is_refused_and_not_read_as_its_first_frame(tmp_path):
    path = tmp_path / "stack.webp"
    first, *others = (PIL.Image.fromarray(np.full((48, 64, 3), 40 * n, np.uint8)) for n in range(3))
    first.save(path, save_all=True, append_images=others)
    says = refusal(path, lambda file: [picture.read() for picture in planes_of(file)])
    assert "it is an animation of 3 frames" in says


def test_a_blank_webp_of_a_common_camera_is_read(tmp_path):
    path = tmp_path / "blank.webp"
    PIL.Image.new("RGB", (2448, 2048), (9, 9, 9)).save(path, lossless=True)
    assert planes_of(path)[0].read().shape == (2048, 2448)


def test_a_compressed_tiff_of_too_many_pixels_is_refused(tmp_path):
    path = tmp_path / "large.tif"
    strip = tifffile.imwrite(path, np.zeros((64, 64), np.uint8), compression="zlib", returnoffset=True)
    del strip
    content = bytearray(path.read_bytes())
    with tifffile.TiffFile(path) as file:
        for name in ("ImageWidth", "ImageLength"):
            tag = file.pages.first.tags[name]
            content[tag.offset + 8 : tag.offset + 12] = struct.pack("<HH", 40_000, 0)
            content[tag.offset + 2 : tag.offset + 4] = struct.pack("<H", 3)
    path.write_bytes(content)
    says = refusal(path, lambda file: [picture.read() for picture in planes_of(file)])
    assert "has 40000 x 40000 pixels, more than 179 million" in says


@pytest.mark.parametrize("ending", [".csv", ".xyz"])
def test_one_stray_point_does_not_take_the_memory_of_a_wafer(tmp_path, ending):
    path = tmp_path / f"stray{ending}"
    points = [(x, y, 1.0) for y in range(20) for x in range(30)] + [(19_000.0, 19_000.0, 1.0)]
    path.write_text("".join(f"{x} {y} {z}\n" for x, y, z in points))
    says = refusal(path, lambda file: read_surface(file, pixel_um=1.0, z_unit="um"))
    assert "would have 19001 x 19001 pixels of 1 um, too many for its points" in says


def test_scattered_points_are_averaged_in_their_pixels(tmp_path):
    path = tmp_path / "scattered.csv"
    path.write_text("x_um,y_um,z_um\n0,0,1\n0.23,0.17,3\n1.11,0.031,5\n0.037,1,7\n1.29,0.917,9\n")
    assert read_surface(path, pixel_um=1.0).z_um.tolist() == [[7.0, 9.0], [2.0, 5.0]]


def test_a_header_of_more_points_than_bytes_is_cut_off(tmp_path):
    path = tmp_path / "many.ply"
    head = "ply\nformat ascii 1.0\ncomment unit: um\nelement vertex 99999999999999\n"
    path.write_text(head + "property float x\nproperty float y\nproperty float z\nend_header\n0 0 1\n")
    assert "fewer points than its header states" in refusal(path, read_surface)


def test_an_x3p_that_unpacks_to_far_more_than_its_file_is_refused(tmp_path):
    path, out = tmp_path / "bomb.x3p", io.BytesIO()
    export(make_surface(), path)
    with zipfile.ZipFile(path) as good, zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as bad:
        bad.writestr("main.xml", good.read("main.xml"))
        bad.writestr("bindata/data.bin", bytes(260_000_000))
    path.write_bytes(out.getvalue())
    assert "unpacks to 260.0 MB, more than 256.0 MB" in refusal(path, read_surface)


@pytest.mark.parametrize("wrong", [b"\xb5", b"\xff\xfe", b"\xc3", b"\x00"])
def test_a_dataset_in_another_encoding_is_refused(tmp_path, wrong):
    job = make_job()
    with DatasetWriter.create(tmp_path / "a.wafer", make_plan(job), job):
        pass
    record, journal = tmp_path / "a.wafer" / "scan.json", tmp_path / "a.wafer" / "journal.jsonl"
    good = record.read_bytes()
    for place in (b'": "', b'"', b"{"):
        record.write_bytes(strip_checksum(good).replace(place, place + wrong, 1))
        assert "scan.json" in refusal(record, lambda file: Dataset.open(file.parent))
    record.write_bytes(good)
    journal.write_bytes((b'{"type":"fault","what":"' + wrong + b'","time":"","x":1' + wrong + b"}\n") * 2)
    assert "journal.jsonl is damaged in line 1" in refusal(journal, lambda file: Dataset.open(file.parent))


def test_a_small_file_takes_no_more_memory_than_it_has(tmp_path):
    path = tmp_path / "scan.json"
    path.write_bytes(b"{}")
    tracemalloc.start()
    try:
        assert read_content(path, most=2_000_000_000) == b"{}"
        assert tracemalloc.get_traced_memory()[1] < 1_000_000
    finally:
        tracemalloc.stop()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no named pipes")
def test_a_pipe_is_read_to_its_end(tmp_path):
    path, content = tmp_path / "pipe", bytes(range(256)) * 1000
    os.mkfifo(path)
    writer = threading.Thread(target=path.write_bytes, args=(content,))
    writer.start()
    assert read_content(path) == content
    writer.join()
