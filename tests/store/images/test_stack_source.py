"""What image files say of themselves is used, and what contradicts it is refused."""

from __future__ import annotations

import json

import numpy as np
import pytest
import tifffile
from PIL import Image as PillowImage

from wafer_viewer.cli.app import main
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.stack_import import import_dataset, open_stack

STEP_UM, PIXEL_UM, N, ROWS, COLS = 2.5, 0.65, 6, 12, 16
GIVEN = {"z_step_um": STEP_UM, "pixel_um": PIXEL_UM}
LENGTHS = {
    "PhysicalSizeX": PIXEL_UM,
    "PhysicalSizeXUnit": "µm",
    "PhysicalSizeY": PIXEL_UM,
    "PhysicalSizeYUnit": "µm",
    "PhysicalSizeZ": STEP_UM,
    "PhysicalSizeZUnit": "µm",
}
IMAGEJ = {"imagej": True, "resolution": (1 / PIXEL_UM, 1 / PIXEL_UM)}


def images(n=N, seed=0, dtype=np.uint16):
    return np.random.default_rng(seed).integers(0, 65535, (n, ROWS, COLS)).astype(dtype)


def imagej(path, values=None, axes="ZYX", **words):
    words = {"axes": axes, "spacing": STEP_UM, "unit": "um"} | words
    tifffile.imwrite(path, images() if values is None else values, **IMAGEJ, metadata=words)
    return path


def ome(path, values=None, axes="ZYX", **words):
    tifffile.imwrite(
        path, images() if values is None else values, ome=True, metadata={"axes": axes, **LENGTHS, **words}
    )
    return path


def nanometres(path):
    return ome(path, PhysicalSizeZ=1000 * STEP_UM, PhysicalSizeZUnit="nm")


def micro_manager(path):
    """Pages with the words of Micro-Manager, in another order than that of z."""
    with tifffile.TiffWriter(path) as file:
        for k in (3, 0, 5, 1, 4, 2):
            words = {"ZPositionUm": 100 + k * STEP_UM, "SliceIndex": k, "PixelSizeUm": PIXEL_UM, "Exposure-ms": 12}
            tag = (51123, 2, 0, json.dumps(words), True)
            file.write(images()[k], extratags=[tag], metadata=None, contiguous=False)
    return path


def by_times(path):
    return imagej(path, axes="TYX")


def big(path):
    """A BigTIFF, as programs write it for stacks over 4 GB."""
    tifffile.imwrite(path, images(), bigtiff=True, ome=True, metadata={"axes": "ZYX", **LENGTHS})
    return path


SAID = {
    "big.btf": big,
    "imagej.tif": imagej,
    "a.ome.tif": ome,
    "nm.ome.tif": nanometres,
    "times.tif": by_times,
    "mm.tif": micro_manager,
}


@pytest.mark.parametrize("name", SAID)
def test_lengths_that_a_file_says_are_used(tmp_path, name):
    stack = open_stack(SAID[name](tmp_path / name))
    assert stack.pixel_um == pytest.approx(PIXEL_UM)
    np.testing.assert_allclose(stack.z_um, STEP_UM * np.arange(N))
    np.testing.assert_array_equal(stack.images, images())
    assert any(note.startswith("The z step is 2.5 um") for note in stack.notes)


@pytest.mark.parametrize("name", SAID)
def test_given_length_that_contradicts_a_file_is_refused_with_both(tmp_path, name):
    path = SAID[name](tmp_path / name)
    with pytest.raises(
        DatasetError, match=r"z step is given as 3 um, and the images say 2.5 um \([\w ]+\).*--overrule"
    ):
        open_stack(path, z_step_um=3.0)
    with pytest.raises(DatasetError, match=r"pixel size is given as 0.5 um, and the images say 0.65 um"):
        open_stack(path, pixel_um=0.5)
    overruled = open_stack(path, z_step_um=3.0, pixel_um=0.5, overrule=True)
    assert overruled.pixel_um == 0.5
    np.testing.assert_allclose(overruled.z_um, 3.0 * np.arange(N))
    np.testing.assert_array_equal(open_stack(path, z_step_um=-3.0, overrule=True).images, images()[::-1])
    assert len(open_stack(path, **GIVEN).images) == N


def test_files_that_contradict_each_other_are_refused(tmp_path):
    for n, pixel_um in enumerate((0.5, 0.5, 0.6)):
        tifffile.imwrite(
            tmp_path / f"{n}.ome.tif",
            images(1)[0],
            ome=True,
            metadata={"axes": "YX", **LENGTHS, "PhysicalSizeX": pixel_um},
        )
    with pytest.raises(
        DatasetError, match=r"contradict each other: the pixel is 0\.5 in 0\.ome\.tif and 0\.6 in 2\.ome\.tif"
    ):
        open_stack(tmp_path)


def test_channels_are_chosen_by_name_or_number(tmp_path):
    values = np.stack([images(seed=n) for n in range(3)], 1)
    path = ome(tmp_path / "c.ome.tif", values, "ZCYX", Channel={"Name": ["blue", "green", "red"]})
    with pytest.raises(
        DatasetError, match=r"have 3 channels: blue, green, red\. Say which to take, as in --channel 'blue'"
    ):
        open_stack(path)
    np.testing.assert_array_equal(open_stack(path, channel="green").images, images(seed=1))
    np.testing.assert_array_equal(open_stack(path, channel="2").images, images(seed=2))
    with pytest.raises(DatasetError, match="There is no channel 'grey': the images have blue, green, red"):
        open_stack(path, channel="grey")
    hyperstack = imagej(tmp_path / "t.tif", np.stack([images(seed=n) for n in range(2)]), "TZYX")
    with pytest.raises(DatasetError, match="have 2 times: time 0, time 1"):
        open_stack(hyperstack)
    np.testing.assert_array_equal(open_stack(hyperstack, time="1").images, images(seed=1))


def test_positions_become_fields_in_their_places(tmp_path):
    places = [(0.0, 0.0), (8.0, 0.0), (0.0, -6.0), (8.0, -6.0)]
    path = tmp_path / "p.ome.tif"
    with tifffile.TiffWriter(path, ome=True) as file:
        for n, (x, y) in enumerate(places):
            plane = {"PositionX": [x] * N, "PositionY": [y] * N, "PositionZ": [5 + k * STEP_UM for k in range(N)]}
            plane |= {f"Position{axis}Unit": ["µm"] * N for axis in "XYZ"}
            file.write(images(seed=n), metadata={"axes": "ZYX", "Name": f"Pos{n}", "Plane": plane, **LENGTHS})
    data = import_dataset(path, tmp_path / "a.wafer")
    assert [(field.x_um, field.y_um) for field in data.fields] == places
    assert [(field.row, field.col) for field in data.fields] == [(0, 0), (0, 1), (1, 0), (1, 1)]
    np.testing.assert_array_equal(data.stack(3).images, images(seed=2))
    np.testing.assert_allclose(data.stack(3).z_um, STEP_UM * np.arange(N))
    assert data.check().ok
    with pytest.raises(DatasetError, match=r"have 4 positions: Pos0, Pos1, Pos2, Pos3\. Choose one with --position"):
        open_stack(path)
    np.testing.assert_array_equal(open_stack(path, position="Pos3").images, images(seed=3))


def test_floating_point_stack_becomes_16_bits_alike(tmp_path):
    values = np.linspace(0, 1, N)[:, None, None] * np.ones((N, ROWS, COLS))
    path = imagej(tmp_path / "f.tif", values.astype(np.float32))
    stack = open_stack(path)
    np.testing.assert_array_equal(stack.images[:, 0, 0], np.rint(np.linspace(0, 65535, N)))
    assert any("scaled to 16 bits" in note for note in stack.notes)
    assert main(["import", str(path), "-o", str(tmp_path / "f.wafer")]) == 0
    assert len(Dataset.open(tmp_path / "f.wafer").stack(1).images) == N


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("ending", [".jpg", ".png", ".tif"])
def test_images_are_read_as_they_are_shown(tmp_path, orientation, ending):
    block = np.zeros((16, 24), np.uint8)
    block[:8, :8], block[8:, :8], block[:8, 16:] = 255, 160, 80
    about = PillowImage.Exif()
    about[0x0112] = orientation
    for k in range(3):
        PillowImage.fromarray(block).save(tmp_path / f"{k}{ending}", exif=about)
    shown = open_stack(tmp_path, **GIVEN).images[0]
    at = {255: (shown > 220), 160: (shown > 130) & (shown < 190), 80: (shown > 60) & (shown < 100)}
    expected = {1: block, 2: block[:, ::-1], 3: block[::-1, ::-1], 4: block[::-1], 5: block.T}
    expected |= {6: np.rot90(block, -1), 7: block[::-1, ::-1].T, 8: np.rot90(block)}
    for grey, where in at.items():
        assert np.mean(where == (expected[orientation] == grey)) > 0.95


@pytest.mark.parametrize(
    ("name", "kind"),
    [("a.oir", "Evident"), ("a.ims", "Imaris"), ("a.heic", "compressed image")],
)
def test_file_of_a_kind_that_is_not_read_is_named(tmp_path, name, kind, capsys):
    (tmp_path / name).write_bytes(bytes(64))
    for source in (tmp_path / name, tmp_path):
        with pytest.raises(DatasetError, match=rf"^{name} is an? {kind}.*, which is not read: "):
            open_stack(source)
    assert main(["import", str(tmp_path / name), "-o", str(tmp_path / "a.wafer")]) == 2
    assert kind in capsys.readouterr().err


def test_missing_frame_stays_empty_in_a_dataset(tmp_path, capsys):
    for k in range(8):
        if k != 4:
            tifffile.imwrite(tmp_path / f"f{k}.tif", images(1, k)[0])
    command = ["import", str(tmp_path), "-o", str(tmp_path / "a.wafer"), "--z-step-um", "2", "--pixel-um", "1"]
    assert main(command) == 0
    assert "number 4 is missing" in capsys.readouterr().err
    stack = Dataset.open(tmp_path / "a.wafer").stack(1)
    assert stack.present.tolist() == [True] * 4 + [False] + [True] * 3
    assert stack.z_um[-1] == 14


def test_pattern_reads_z_and_a_running_number(tmp_path):
    for n in range(2):
        for z in (-4, 0, 4):
            tifffile.imwrite(tmp_path / f"t{n}_z{z:+d}.tif", images(1, 10 * n + z + 4)[0])
    data = import_dataset(tmp_path, tmp_path / "a.wafer", pattern="t{n}_z{z}.tif", pixel_um=1.0)
    assert len(data.fields) == 2
    np.testing.assert_allclose(data.stack(2).z_um, [0, 4, 8])
    np.testing.assert_array_equal(data.stack(2).images[0], images(1, 10)[0])


def test_order_that_the_images_contradict_is_refused_until_it_is_confirmed(tmp_path):
    texture = np.random.default_rng(1).normal(0, 40, (48, 96))
    at = np.linspace(3, 17, 96)[None]
    for k in range(20):
        light = 128 + texture * np.exp(-(((k - at) / 3) ** 2))
        tifffile.imwrite(tmp_path / f"f{(k + 12) % 20:02d}.tif", light.clip(0, 255).astype(np.uint8))
    with pytest.raises(
        DatasetError, match=r"contradict the order of their names: .* f12.tif, f13.tif, f14.tif ... f11"
    ):
        open_stack(tmp_path, **GIVEN)
    with pytest.raises(DatasetError, match="contradict the order of their names"):
        import_dataset(tmp_path, tmp_path / "a.wafer", **GIVEN)
    assert not (tmp_path / "a.wafer").exists()
    assert len(open_stack(tmp_path, **GIVEN, as_listed=True).images) == 20
    right = [tmp_path / f"f{(k + 12) % 20:02d}.tif" for k in range(20)]
    assert len(open_stack(right, **GIVEN).images) == 20


ABOUT = """<?xml version="1.0" encoding="UTF-8"?>
<OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06">
<Instrument ID="Instrument:0"><Objective ID="Objective:0" Model="Plan 20x" LensNA="0.45"/></Instrument>
<Image ID="Image:0"><AcquisitionDate>2024-05-06T07:08:09</AcquisitionDate><ObjectiveSettings ID="Objective:0"/>
<Pixels ID="Pixels:0" DimensionOrder="XYZCT" Type="uint16" SizeX="16" SizeY="12" SizeZ="6" SizeC="1" SizeT="1"
PhysicalSizeX="0.65" PhysicalSizeY="0.65" PhysicalSizeZ="2.5"><Channel ID="Channel:0:0" SamplesPerPixel="1"/>
<TiffData IFD="0" PlaneCount="6"/>%s</Pixels></Image></OME>"""
PLANE = '<Plane TheZ="%d" TheC="0" TheT="0" ExposureTime="%g" ExposureTimeUnit="ms" DeltaT="%g"/>'


def timed(path, exposures_ms):
    planes = "".join(PLANE % (k, ms, 0.5 * k) for k, ms in enumerate(exposures_ms))
    tifffile.imwrite(path, images(), description=ABOUT % planes, metadata=None, photometric="minisblack")
    return path


def test_exposures_times_objective_and_date_are_stored(tmp_path):
    path = timed(tmp_path / "a.ome.tif", [12] * N)
    assert open_stack(path).exposure_us == 12_000
    data = import_dataset(path, tmp_path / "a.wafer")
    assert data.scan.setup.objective == "Plan 20x NA 0.45"
    assert data.scan.imported_from == "a.ome.tif, taken 2024-05-06T07:08:09"
    assert data.stack(1).exposure_us == 12_000
    assert [line.device_time_us for line in data.journal_lines(data.field(1))] == [500_000 * k for k in range(N)]
    again = import_dataset(tmp_path / "a.wafer" / "frames", tmp_path / "b.wafer")
    assert again.scan.setup == data.scan.setup
    assert again.scan.plan.exposures_us == (12_000,)
    assert again.stack(1).depth_of_field_um == data.stack(1).depth_of_field_um > 0


def test_unknown_exposures_stay_unknown_and_changing_ones_are_noted(tmp_path):
    assert not import_dataset(ome(tmp_path / "a.ome.tif"), tmp_path / "a.wafer").scan.plan.exposures_are_known
    path = timed(tmp_path / "b.ome.tif", [12] * 5 + [24])
    notes = open_stack(path).notes
    assert import_dataset(path, tmp_path / "b.wafer").stack(1).notes == notes
    assert any("exposure time changes from 12000 to 24000 us" in note for note in notes)


@pytest.mark.parametrize("places", [None, [(0, 0), (0, 0)]])
def test_positions_without_distinct_places_are_asked_for(tmp_path, places):
    path = tmp_path / "p.ome.tif"
    with tifffile.TiffWriter(path, ome=True) as file:
        for n in range(2):
            lengths = {**LENGTHS, "PhysicalSizeX": PIXEL_UM * (n + 1), "PhysicalSizeY": PIXEL_UM * (n + 1)}
            if places:
                lengths = LENGTHS | {"Plane": {"PositionX": [places[n][0]] * N, "PositionY": [places[n][1]] * N}}
            file.write(images(seed=n), metadata={"axes": "ZYX", "Name": f"Pos{n}", **lengths})
    with pytest.raises(
        DatasetError, match=r"not say where.*: Pos0, Pos1" if not places else r"same place\. Choose one .*: Pos0, Pos1"
    ):
        import_dataset(path, tmp_path / "a.wafer")
    assert open_stack(path, position="Pos1").pixel_um == pytest.approx(PIXEL_UM * (1 if places else 2))


@pytest.mark.parametrize("ending", [".jpg", ".png", ".webp"])
def test_exif_states_exposure_date_and_the_order_of_a_rolled_counter(tmp_path, ending):
    for k, number in enumerate((9998, 9999, 1, 2, 3)):
        about = PillowImage.Exif()
        about[0x0112] = 1
        about.get_ifd(0x8769).update({0x9003: f"2024:05:06 07:08:{k:02d}", 0x9291: "50", 0x829A: 0.004})
        PillowImage.fromarray(np.full((16, 16), 40 * k, np.uint8)).save(
            tmp_path / f"IMG_{number:04d}{ending}", exif=about
        )
    stack = open_stack(tmp_path, **GIVEN)
    assert np.all(np.diff(stack.images[:, 8, 8].astype(int)) > 20)
    assert stack.exposure_us == pytest.approx(4000)
    imported = import_dataset(tmp_path, tmp_path / "a.wafer", **GIVEN, as_listed=True)
    assert imported.scan.imported_from.endswith("taken 2024-05-06T07:08:02.50")
