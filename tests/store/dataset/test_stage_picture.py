"""Single pictures of the camera: all bits, place and pixel size for other programs, first free name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import tifffile

from wafer_viewer.model.acquisition.calibration import OpticalSetup
from wafer_viewer.model.acquisition.devices import Position
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.dataset import ome_header
from wafer_viewer.store.dataset.ome_header import StagePicture, write_stage_picture

IMAGE = np.random.default_rng(2).integers(0, 65535, (24, 32), np.uint16)
PICTURE = StagePicture(
    image=IMAGE,
    position=Position(1250.5, -300.25, 12.125),
    exposure_us=120.0,
    taken="2026-11-23T21:15:30.250+00:00",
    pixel_um=0.467,
    bits=12,
    rig="bench <&> µ",
    setup=OpticalSetup(objective="10x/0.28", camera="camera"),
    simulated=True,
)


@pytest.mark.slow
def test_other_programs_read_pixels_place_exposure_and_time(tmp_path):
    import ome_types

    path = write_stage_picture(tmp_path, PICTURE)
    np.testing.assert_array_equal(tifffile.imread(path), IMAGE)
    with tifffile.TiffFile(path) as file:
        assert file.pages[0].get_resolution("MICROMETER") == pytest.approx((1 / 0.467,) * 2, rel=1e-5)
    ome = ome_types.from_xml(tifffile.tiffcomment(path), validate=True)
    image = ome.images[0]
    plane, pixels = image.pixels.planes[0], image.pixels
    assert image.acquisition_date.isoformat().startswith("2026-11-23T21:15:30")
    assert (plane.position_x, plane.position_y, plane.position_z) == (1250.5, -300.25, 12.125)
    assert plane.exposure_time == pytest.approx(120e-6)
    assert (pixels.physical_size_x, pixels.significant_bits, pixels.type.value) == (0.467, 12, "uint16")
    assert image.description.startswith("SIMULATED.")
    assert ome.instruments[0].objectives[0].lens_na == 0.28


def test_every_picture_has_a_file_of_its_own(tmp_path):
    import ome_types

    eight_bit = replace(PICTURE, image=IMAGE.astype(np.uint8), pixel_um=None, bits=8)
    paths = [write_stage_picture(tmp_path, picture) for picture in (PICTURE, eight_bit, PICTURE)]
    assert [path.name for path in paths] == [f"live-picture-{n}.ome.tif" for n in (1, 2, 3)]
    assert tifffile.imread(paths[1]).dtype == np.uint8
    assert ome_types.from_tiff(paths[1]).images[0].pixels.physical_size_x is None


def test_a_failure_leaves_no_file(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(ome_header, "picture_xml", full)
    with pytest.raises(DatasetError, match="the disk is full"):
        write_stage_picture(tmp_path, PICTURE)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(DatasetError, match="its folder does not exist"):
        write_stage_picture(tmp_path / "nowhere", PICTURE)
