"""A look at files that may be imported reads headers once, and frames again only when their file has changed."""

from __future__ import annotations

import os
from collections import Counter

import pytest
import tifffile

from tests.cli.test_inspect import frames
from wafer_viewer.model.acquisition.image_source import ImageOptions
from wafer_viewer.model.surface_format import Reading
from wafer_viewer.session.surface.worker_tasks import look_at_files
from wafer_viewer.store.dataset import file_contents as module
from wafer_viewer.store.dataset.file_contents import file_contents


@pytest.fixture
def folder(tmp_path):
    for k, image in enumerate(frames()):
        tifffile.imwrite(tmp_path / f"img_{k:03d}.tif", image)
    return tmp_path


def blacken(path, *, later):
    """Write a black image of the same size in the place of another; its time is the same, or later."""
    image, state = tifffile.imread(path), path.stat()
    tifffile.imwrite(path, image * 0)
    os.utime(path, ns=(state.st_atime_ns, state.st_mtime_ns + later))


def test_typed_numbers_read_no_frame_again(folder):
    contents, thumbnails, seen = look_at_files((folder,), ImageOptions(), Reading(), 5)
    assert len(seen.pictures) == len(seen.sharpness) == len(contents.frames)
    for path in folder.iterdir():
        blacken(path, later=0)
    lengths = ImageOptions(pixel_um=0.5, z_step_um=2.0)
    again, same, seen = look_at_files((folder,), lengths, Reading(), 5, seen)
    assert not again.doubts
    assert same == thumbnails
    assert [frame.sharpness for frame in again.frames] == [frame.sharpness for frame in contents.frames]

    blacken(folder / "img_000.tif", later=1)
    _, changed, _ = look_at_files((folder,), lengths, Reading(), 5, seen)
    assert changed[0] != thumbnails[0]
    assert {k: jpeg for k, jpeg in changed.items() if k} == {k: jpeg for k, jpeg in thumbnails.items() if k}


@pytest.mark.parametrize("options", [ImageOptions(), ImageOptions(pattern="img_{n}.tif", columns=4)])
def test_each_header_is_read_once(folder, monkeypatch, options):
    read, planes_of = Counter(), module.planes_of

    def counted(path):
        read[path.name] += 1
        return planes_of(path)

    monkeypatch.setattr(module, "planes_of", counted)
    contents = file_contents(folder, options, look=False)
    assert contents.doubts  # each open value is settled by a placeholder, and the source sorted anew
    assert set(read.values()) == {1}
    assert len(read) == len(list(folder.iterdir()))
