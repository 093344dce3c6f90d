from __future__ import annotations

import os

import imagecodecs
import numpy as np
import pytest
import tifffile
from PIL import Image as PillowImage

from wafer_viewer.model.acquisition.calibration import depth_of_field_um
from wafer_viewer.model.acquisition.plan import Shot
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.reconstruct.field_pipeline import reconstruct
from wafer_viewer.store.dataset.stack_import import import_dataset, open_stack
from wafer_viewer.store.images.image_files import REC_709, planes_of

STEP = {"z_step_um": 4.0, "pixel_um": 0.5}


def grey(seed, rows=12, cols=16, dtype=np.uint8):
    return np.random.default_rng(seed).integers(0, np.iinfo(dtype).max, (rows, cols), dtype)


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def write(path, image):
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".tif":
        tifffile.imwrite(path, image, photometric="rgb" if image.shape[-1] == 3 else "minisblack")
    elif path.suffix == ".png":
        path.write_bytes(imagecodecs.png_encode(image))
    else:
        PillowImage.fromarray(image).save(path, quality=95)


@pytest.fixture(scope="module")
def tilted():
    """The light of a rough, tilted plane in eleven frames, each sharp in other columns."""
    rng = np.random.default_rng(3)
    texture, lighting = rng.normal(0, 40, (48, 96)), np.linspace(90, 190, 96)
    away = np.arange(96)[None] / 96 * 8 + 1 - np.arange(11)[:, None]
    return np.stack([lighting + texture * np.exp(-(blur**2) / 2) for blur in away]).clip(0, 255)


@pytest.fixture
def folder(tmp_path):
    """Twelve images whose names sort wrongly as text."""
    for k in range(12):
        write(tmp_path / f"stack/im{k}.png", grey(k))
    return tmp_path / "stack"


def test_a_folder_is_read_in_the_order_people_count_in(folder):
    stack = open_stack(folder, **STEP)
    np.testing.assert_array_equal(stack.images, [grey(k) for k in range(12)])
    np.testing.assert_allclose(stack.z_um, 4.0 * np.arange(12))
    assert stack.present.all()
    assert stack.pixel_um == 0.5
    assert stack.calibration is None
    assert not stack.simulated


def test_a_list_of_files_and_a_multi_page_tiff_are_the_same_stack(folder, tmp_path):
    tifffile.imwrite(tmp_path / "all.tif", np.array([grey(k) for k in range(12)]), photometric="minisblack")
    a = open_stack([str(folder / f"im{k}.png") for k in range(12)], **STEP)
    b = open_stack(str(tmp_path / "all.tif"), **STEP)
    np.testing.assert_array_equal(a.images, b.images)
    assert a.checksum == b.checksum


def test_frames_taken_downward_are_turned_round(folder):
    stack = open_stack(folder, z_step_um=-4.0, pixel_um=0.5, z_start_um=100.0)
    np.testing.assert_array_equal(stack.images[0], grey(11))
    np.testing.assert_allclose(stack.z_um, 100 + 4.0 * np.arange(12))


@pytest.mark.parametrize("ending", [".png", ".tif"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_colour_becomes_luminance_and_keeps_its_depth(tmp_path, ending, dtype):
    color = np.random.default_rng(1).integers(0, np.iinfo(dtype).max, (12, 16, 3), dtype)
    write(tmp_path / f"a{ending}", color)
    (picture,) = planes_of(tmp_path / f"a{ending}")
    assert picture.read().dtype == dtype
    np.testing.assert_array_equal(picture.read(), np.rint(color @ REC_709).astype(dtype))


def test_white_stays_white(tmp_path):
    write(tmp_path / "a.png", np.full((4, 4, 4), 255, np.uint8))
    assert (planes_of(tmp_path / "a.png")[0].read() == 255).all()


KINDS = [
    *((".tif", mode) for mode in ("L", "RGB", "P", "1", "CMYK", "LA")),
    *((".png", mode) for mode in ("L", "RGB", "P", "1", "LA", "RGBA")),
    *((".jpg", mode) for mode in ("L", "RGB", "CMYK")),
    *((".bmp", mode) for mode in ("L", "RGB", "P", "1")),
]


@pytest.mark.parametrize(("ending", "mode"), KINDS)
def test_whatever_pillow_writes_is_read_as_pillow_reads_it(tmp_path, ending, mode):
    image = PillowImage.fromarray(grey(1)).convert(mode)
    path = tmp_path / f"a{ending}"
    image.save(path)
    with PillowImage.open(path) as written:
        expected = np.asarray(written.convert("L"), int)
    assert np.abs(planes_of(path)[0].read().astype(int) - expected).max() <= 2


def test_compressed_big_endian_and_planar_tiffs(tmp_path):
    image = grey(1, dtype=np.uint16)
    tifffile.imwrite(tmp_path / "a.tif", image, compression="lzw", byteorder=">")
    np.testing.assert_array_equal(planes_of(tmp_path / "a.tif")[0].read(), image)
    color = np.stack([grey(k) for k in range(3)])
    tifffile.imwrite(tmp_path / "b.tif", color, photometric="rgb", planarconfig="separate")
    expected = np.rint(np.moveaxis(color, 0, -1) @ REC_709)
    np.testing.assert_array_equal(planes_of(tmp_path / "b.tif")[0].read(), expected)


def test_a_stack_becomes_a_dataset(folder, tmp_path):
    fractions = []
    data = import_dataset(folder, tmp_path / "a.wafer", progress=fractions.append, **STEP)
    np.testing.assert_array_equal(data.stack(1).images, [grey(k) for k in range(12)])
    assert data.finished
    assert data.check().ok
    assert not data.simulated
    assert data.scan.imported_from == "stack"
    assert data.calibration_problem("2026-01-01") == "what was imported carries no calibration"
    assert fractions == pytest.approx([(k + 1) / 12 for k in range(12)])
    assert names(tmp_path) == [".wafer-viewer", "a.wafer", "stack"]


def grid(root, cells, n_frames=4, name="r{}_c{}_k{}.tif", dtype=np.uint8):
    for row, col in cells:
        for k in range(n_frames):
            write(root / name.format(row, col, k), grey([row, col, k], dtype=dtype))
    return root


def test_a_grid_of_fields_is_identified_by_the_names(tmp_path):
    cells = [(1, 1), (1, 2), (2, 1), (2, 2), (2, 10)]
    src = grid(tmp_path / "src", cells, dtype=np.uint16)
    data = import_dataset(src, tmp_path / "a.wafer", pattern="r{row}_c{col}_k{k}.tif", overlap_fraction=0.25, **STEP)
    assert [(f.row, f.col) for f in data.fields] == [(r - 1, c - 1) for r, c in cells]
    assert [f.x_um for f in data.fields] == pytest.approx([0.75 * 8 * (c - 1) for _, c in cells])
    assert [f.y_um for f in data.fields] == pytest.approx([-0.75 * 6 * (r - 1) for r, _ in cells])
    assert data.scan.assumed_overlap == 0.25
    assert data.stack(5).positions_assumed
    np.testing.assert_array_equal(data.stack(5).images[3], grey([2, 10, 3], dtype=np.uint16))
    assert data.check().ok


def test_a_grid_of_multi_page_files_and_of_folders(tmp_path):
    for row, col in ((0, 0), (0, 1)):
        (tmp_path / "pages").mkdir(exist_ok=True)
        stack = np.array([grey([row, col, k]) for k in range(4)])
        tifffile.imwrite(tmp_path / f"pages/r{row}c{col}.tif", stack, photometric="minisblack")
    src = grid(tmp_path / "folders", [(0, 0), (0, 1)], name="r{}c{}/image {}.png")
    a = import_dataset(tmp_path / "pages", tmp_path / "a.wafer", pattern="r{row}c{col}.tif", **STEP)
    b = import_dataset(src, tmp_path / "b.wafer", pattern="r{row}c{col}/image {k}.png", **STEP)
    np.testing.assert_array_equal(a.stack(2).images, b.stack(2).images)


def test_a_frame_that_others_have_is_an_empty_slot(tmp_path):
    src = grid(tmp_path / "src", [(0, 0), (0, 1)])
    (src / "r0_c1_k2.tif").unlink()
    data = import_dataset(src, tmp_path / "a.wafer", pattern="r{row}_c{col}_k{k}.tif", **STEP)
    assert data.stack(2).present.tolist() == [True, True, False, True]
    assert data.missed() == {Shot(2, 2): "there was no such image"}
    assert data.finished


BRACKETS = {
    "e{e}/z{k}.png": "e{}/z{}.png",
    "r{row}c{col}_k{k}_e{e}.tif": "r0c0_k{1}_e{0}.tif",
}


@pytest.mark.slow
@pytest.mark.parametrize("pattern", BRACKETS)
def test_exposures_are_identified_by_the_names_and_fused(tmp_path, tilted, pattern):
    for number, gain in ((1, 0.5), (2, 1.0)):
        for k, light in enumerate(tilted):
            write(tmp_path / "src" / BRACKETS[pattern].format(number, k), (gain * light).clip(0, 255).astype(np.uint8))
    data = import_dataset(tmp_path / "src", tmp_path / "a.wafer", pattern=pattern, **STEP)
    assert data.n_exposures == 2
    assert data.check().ok
    np.testing.assert_array_equal(data.stack(1, exposure=0).images, (0.5 * tilted).astype(np.uint8))
    height = reconstruct(data.stack(1))
    assert any(
        note.startswith("2 exposures were fused, the longer ones x2 as bright") for note in height.provenance.notes
    )
    assert height.measured.mean() > 0.9


def test_a_field_of_several_pages_in_each_exposure(tmp_path):
    (tmp_path / "src").mkdir()
    for e in (0, 1):
        images = np.array([grey([e, k]) for k in range(4)])
        tifffile.imwrite(tmp_path / f"src/exposure {e}.tif", images, photometric="minisblack")
    data = import_dataset(tmp_path / "src", tmp_path / "a.wafer", pattern="exposure {e}.tif", **STEP)
    np.testing.assert_array_equal(data.stack(1).brackets[0].images[3], grey([1, 3]))


def test_an_exposure_that_lacks_a_frame_leaves_its_slot_out(tmp_path):
    src = grid(tmp_path / "src", [(0, 0), (1, 0)], name="e{}_c{}_k{}.tif")
    (src / "e1_c0_k2.tif").unlink()
    data = import_dataset(src, tmp_path / "a.wafer", pattern="e{e}_c0_k{k}.tif", **STEP)
    assert data.missed() == {Shot(1, 2, 1): "there was no such image"}
    (src / "e0_c0_k3.tif").unlink()
    with pytest.raises(DatasetError, match="has 2 frames and at least 3 are needed"):
        import_dataset(src, tmp_path / "b.wafer", pattern="e{e}_c0_k{k}.tif", **STEP)


def spoil_size(folder):
    write(folder / "im9.png", grey(9, rows=11))


def spoil_depth(folder):
    write(folder / "im1.png", grey(9, dtype=np.uint16))


def spoil_png(folder):
    (folder / "im4.png").write_bytes((folder / "im4.png").read_bytes()[:-60])


def as_ending(folder, ending):
    """All images in another format, and one more, which is returned."""
    for k in range(12):
        (folder / f"im{k}.png").unlink()
        write(folder / f"im{k}{ending}", grey(k))
    return folder / f"im12{ending}"


def spoil_jpeg(folder):
    more = as_ending(folder, ".jpg")
    write(more, grey(1))
    more.write_bytes(more.read_bytes()[:-90])


def spoil_tiff(folder):
    more = as_ending(folder, ".tif")
    write(more, grey(1))
    os.truncate(more, more.stat().st_size - 100)


def text_named_tif(folder):
    as_ending(folder, ".tif").write_text("no image at all")


def float_tiff(folder):
    tifffile.imwrite(as_ending(folder, ".tif"), np.zeros((12, 16), np.float32))


def only_two(folder):
    for k in range(2, 12):
        (folder / f"im{k}.png").unlink()


def none_at_all(folder):
    only_two(folder)
    for path in folder.iterdir():
        path.rename(path.with_suffix(".txt"))


BAD = [
    (spoil_size, r"Import stopped at im9.png: it is 16 x 11 px, 8 bit, the 9 before it are 16 x 12 px, 8 bit. Nothing"),
    (spoil_depth, r"Import stopped at im1.png: it is 16 x 12 px, 16 bit, the one before it is 16 x 12 px, 8 bit."),
    (spoil_png, r"Import stopped at im4.png: it is damaged, or not an image"),
    (spoil_jpeg, r"Import stopped at im12.jpg: it is damaged, or not an image"),
    (spoil_tiff, r"Import stopped at im12.tif: it is damaged, or not an image"),
    (text_named_tif, r"Import stopped at im12.tif: it is damaged, or not an image \(not a TIFF file"),
    (float_tiff, r"Import stopped at im12.tif: its values are float32"),
    (only_two, r"has 2 frames and at least 3 are needed"),
    (none_at_all, r"the folder holds no images"),
]


@pytest.mark.parametrize(("spoil", "sentence"), BAD, ids=[spoil.__name__ for spoil, _ in BAD])
def test_bad_images_are_named_and_nothing_is_written(folder, tmp_path, spoil, sentence):
    spoil(folder)
    with pytest.raises(DatasetError, match=sentence) as caught:
        import_dataset(folder, tmp_path / "a.wafer", **STEP)
    assert "Nothing was written." in str(caught.value)
    assert "\n" not in str(caught.value)
    assert names(tmp_path) == ["stack"]
    with pytest.raises(DatasetError, match=sentence):
        open_stack(folder, **STEP)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"z_step_um": None}, "The z step is missing: give it with --z-step-um"),
        ({"pixel_um": None}, "The pixel size is missing: give it with --pixel-um"),
        ({"z_step_um": 0.0}, "The z step is 0 um"),
        ({"pixel_um": -1.0}, "The pixel size is -1 um"),
        ({"numerical_aperture": 1.4}, "The numerical aperture is 1.4: in air it lies between 0 and 1"),
        ({"wavelength_um": 550.0}, "The wavelength is 550 um: it must lie from 0.2 to 2.0 um"),
        ({"overlap_fraction": 0.6}, "The overlap is 60% of a field: it must be between 0 % and 50%"),
        ({"pattern": "r{row}.tif"}, "does not say which field a file is"),
        ({"pattern": "r{row}_e{e}.tif"}, "does not say which field a file is"),
        ({"pattern": "r{row}c{col}.png"}, r"im0.png: its name does not fit the pattern 'r\{row\}c\{col\}.png'"),
        ({"srcs": "/nowhere"}, "/nowhere: it does not exist"),
        ({"srcs": []}, "no images were given"),
        ({"out": "nowhere/a.wafer"}, "nowhere/a.wafer cannot be written: its folder does not exist"),
        ({"out": "stack/im0.png/a.wafer"}, "im0.png/a.wafer cannot be written: a part of the path is a file"),
        ({"out": "stack"}, "stack exists already"),
    ],
)
def test_wrong_settings_are_one_sentence(folder, tmp_path, monkeypatch, change, sentence):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(DatasetError, match=sentence):
        import_dataset(**({"srcs": folder, "out": "a.wafer", **STEP} | change))
    assert names(tmp_path) == ["stack"]
    assert len(names(folder)) == 12


def test_the_aperture_gives_images_their_depth_of_field(folder, tmp_path):
    expected_um = depth_of_field_um(0.28, 0.5)
    assert open_stack(folder, **STEP, numerical_aperture=0.28).depth_of_field_um == expected_um
    assert open_stack(folder, **STEP).depth_of_field_um == 0
    given = import_dataset(folder, tmp_path / "a.wafer", **STEP, numerical_aperture=0.28, wavelength_um=0.46)
    assert given.stack(1).depth_of_field_um == depth_of_field_um(0.28, 0.5, 0.46) < expected_um
    assert import_dataset(folder, tmp_path / "b.wafer", **STEP).stack(1).depth_of_field_um == 0


def test_a_frame_that_is_there_twice(tmp_path):
    grid(tmp_path / "src", [(0, 0)])
    write(tmp_path / "src/r00_c0_k1.tif", grey(1))
    with pytest.raises(DatasetError, match="frame 1 of row 0, column 0 is there twice"):
        import_dataset(tmp_path / "src", tmp_path / "a.wafer", pattern="r{row}_c{col}_k{k}.tif", **STEP)


def test_an_import_can_be_stopped(folder, tmp_path):
    answers = iter([False] * 5 + [True])
    with pytest.raises(DatasetError, match="The import was stopped at 5 of 12"):
        import_dataset(folder, tmp_path / "a.wafer", should_stop=lambda: next(answers), **STEP)
    assert names(tmp_path) == ["stack"]
