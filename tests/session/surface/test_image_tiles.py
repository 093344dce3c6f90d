"""Single images become one picture, by patterns, tables, and places that they state, with the table of their places."""

from __future__ import annotations

import csv

import imagecodecs
import numpy as np
import pytest
import tifffile
from scipy.ndimage import gaussian_filter

import wafer_viewer as wv
from wafer_viewer.cli.app import main

PIXEL_UM, SIDE, ROWS, COLS = 0.5, 160, 2, 3
STEP = 136  # 15 % overlap; the default is 10 %


@pytest.fixture
def ground():
    rng = np.random.default_rng(7)
    rough = gaussian_filter(rng.normal(0, 1, (ROWS * STEP + 40, COLS * STEP + 40)), 1.2)
    return (128 + 60 * rough / rough.std()).clip(0, 255).astype(np.uint8)


@pytest.fixture
def corners():
    """Row and column of each image's first pixel, off the grid by up to 3 px."""
    off = np.random.default_rng(8).integers(-3, 4, (ROWS, COLS, 2))
    return {
        (row, col): (4 + row * STEP + int(off[row, col, 0]), 4 + col * STEP + int(off[row, col, 1]))
        for row in range(ROWS)
        for col in range(COLS)
    }


def cut(ground, corner):
    top, left = corner
    noise = np.random.default_rng(top * 1000 + left).normal(0, 2, (SIDE, SIDE))
    return (ground[top : top + SIDE, left : left + SIDE] + noise).clip(0, 255).astype(np.uint8)


def places(table):
    with table.open() as file:
        return {line["file"]: (float(line["x_um"]), float(line["y_um"])) for line in csv.DictReader(file)}


def require_right(found, corners, name):
    """Distances between the images are those of their corners, to a tenth of a pixel."""
    (row0, col0), first = corners[0, 0], found[name(0, 0)]
    for cell, (row, col) in corners.items():
        x_um, y_um = found[name(*cell)]
        assert x_um - first[0] == pytest.approx((col - col0) * PIXEL_UM, abs=0.1 * PIXEL_UM)
        assert first[1] - y_um == pytest.approx((row - row0) * PIXEL_UM, abs=0.1 * PIXEL_UM)


def test_rows_and_columns_in_names(ground, corners, tmp_path, capsys):
    for (row, col), corner in corners.items():
        tifffile.imwrite(tmp_path / f"r{row}_c{col}.tif", cut(ground, corner))
    out, table = tmp_path / "out" / "whole.ome.tif", tmp_path / "out" / "places.csv"
    out.parent.mkdir()
    words = ["stitch-images", str(tmp_path), "--pattern", "r{row}_c{col}.tif", "--pixel-um", str(PIXEL_UM)]
    assert main([*words, "--poses", str(table), "-o", str(out)]) == 0
    assert "6 images, 0 left out" in capsys.readouterr().out
    require_right(places(table), corners, lambda row, col: f"r{row}_c{col}.tif")
    with tifffile.TiffFile(out) as file:
        assert file.is_ome
        assert f'PhysicalSizeX="{PIXEL_UM}"' in (file.ome_metadata or "")
        picture = file.series[0].asarray().astype(float)
    top, left = (min(corner[axis] for corner in corners.values()) for axis in (0, 1))
    like = ground[top : top + picture.shape[0], left : left + picture.shape[1]]
    inner = slice(20, -20)
    assert np.std((picture - like)[inner, inner]) < 4


def test_running_numbers_along_a_snake(ground, corners, tmp_path):
    names = {}
    for n, (row, col) in enumerate([(0, 0), (0, 1), (0, 2), (1, 2), (1, 1), (1, 0)], 1):
        names[row, col] = f"tile_{n:02}.png"
        (tmp_path / names[row, col]).write_bytes(imagecodecs.png_encode(cut(ground, corners[row, col])))
    poses = wv.stitch_images(
        tmp_path,
        tmp_path / "whole.tif",
        tmp_path / "places.csv",
        PIXEL_UM,
        "tile_{n}.png",
        columns=3,
        order="snake-rows",
    )
    assert not poses.left_out.any()
    require_right(places(tmp_path / "places.csv"), corners, lambda row, col: names[row, col])
    with tifffile.TiffFile(tmp_path / "whole.tif") as file:
        assert file.pages.first.get_resolution("MICROMETER") == pytest.approx((1 / PIXEL_UM, 1 / PIXEL_UM))


def test_places_of_a_table_and_those_that_were_found(ground, corners, tmp_path):
    files = tmp_path / "files"
    files.mkdir()
    lines = ["file,x_um,y_um"]
    for (row, col), (top, left) in corners.items():
        tifffile.imwrite(files / f"{row}-{col}.tif", cut(ground, (top, left)))
        lines.append(f"{row}-{col}.tif,{left * PIXEL_UM + 2},{-top * PIXEL_UM - 1}")
    stage = tmp_path / "stage.csv"
    stage.write_text("\n".join(lines))
    wv.stitch_images(files, tmp_path / "a.tif", tmp_path / "a.csv", PIXEL_UM, places=stage)
    require_right(places(tmp_path / "a.csv"), corners, lambda row, col: f"{row}-{col}.tif")
    words = ["stitch-images", str(files), "--pixel-um", str(PIXEL_UM), "--places", str(tmp_path / "a.csv")]
    assert main([*words, "--recipe.stitching.poses", "stage", "-o", str(tmp_path / "b.tif")]) == 0
    np.testing.assert_allclose(
        tifffile.imread(tmp_path / "a.tif").astype(int), tifffile.imread(tmp_path / "b.tif"), atol=1
    )


def test_places_that_files_state(ground, corners, tmp_path):
    for (row, col), (top, left) in corners.items():
        place = {"PositionX": left * PIXEL_UM, "PositionXUnit": "µm", "PositionY": -top * PIXEL_UM}
        tifffile.imwrite(
            tmp_path / f"{row}{col}.ome.tif",
            cut(ground, (top, left)),
            metadata={"axes": "YX", "PhysicalSizeX": PIXEL_UM, "PhysicalSizeY": PIXEL_UM, "Plane": place},
        )
    contents = wv.file_contents(tmp_path)
    assert contents.is_tiled
    assert not contents.doubts
    wv.stitch_images(tmp_path, tmp_path / "whole.ome.tif", tmp_path / "p.csv")
    require_right(places(tmp_path / "p.csv"), corners, lambda row, col: f"{row}{col}.ome.tif")


def test_what_is_missing_is_named_with_the_mend(ground, corners, tmp_path, capsys):
    for (row, col), corner in corners.items():
        tifffile.imwrite(tmp_path / f"r{row}_c{col}.tif", cut(ground, corner))

    def refused(*words):
        assert main(["stitch-images", str(tmp_path), *words]) == 2
        return capsys.readouterr().err

    grid = "--pattern", "r{row}_c{col}.tif"
    assert "--pixel-um" in refused(*grid, "-o", str(tmp_path / "a.tif"))
    assert "--places or --pattern" in refused("--pixel-um", "0.5", "-o", str(tmp_path / "a.tif"))
    assert ".ome.tif" in refused(*grid, "--pixel-um", "0.5", "-o", str(tmp_path / "a.png"))
    assert main(["import", str(tmp_path), *grid, "--pixel-um", "0.5", "-o", str(tmp_path / "a.wafer")]) == 2
    assert "stitch-images" in capsys.readouterr().err
    assert not list(tmp_path.glob("a.*"))
