"""Fields lie where running numbers or a table of places put them."""

from __future__ import annotations

import json

import numpy as np
import pytest
import tifffile

from wafer_viewer.cli.app import main
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.dataset.stack_import import import_dataset

LENGTHS = {"z_step_um": 2.0, "pixel_um": 0.5}
ROWS, COLS = 12, 16
WIDTH_UM, HEIGHT_UM = 0.9 * COLS * 0.5, 0.9 * ROWS * 0.5
"""Pitch of the fields with an overlap of 10 %."""


@pytest.fixture
def tiles(tmp_path):
    """Six stacks of four pages each, tile_01.tif to tile_06.tif; each has its number as its grey."""
    folder = tmp_path / "tiles"
    folder.mkdir()
    for n in range(1, 7):
        tifffile.imwrite(folder / f"tile_{n:02d}.tif", np.full((4, ROWS, COLS), n, np.uint8), photometric="minisblack")
    return folder


def grid(dataset):
    """The greys of the fields by row and column."""
    greys = {(f.row, f.col): int(dataset.stack(f.number, verify=False).images[0, 0, 0]) for f in dataset.fields}
    rows, cols = max(row for row, _ in greys) + 1, max(col for _, col in greys) + 1
    return [[greys.get((row, col), 0) for col in range(cols)] for row in range(rows)]


@pytest.mark.parametrize(
    ("given", "right"),
    [
        ({}, [[1, 2, 3, 4, 5, 6]]),
        ({"columns": 3}, [[1, 2, 3], [4, 5, 6]]),
        ({"columns": 3, "order": "snake-rows"}, [[1, 2, 3], [6, 5, 4]]),
        ({"columns": 3, "order": "columns"}, [[1, 3, 5], [2, 4, 6]]),
        ({"columns": 3, "order": "snake-columns"}, [[1, 4, 5], [2, 3, 6]]),
        ({"columns": 3, "order": "snake-rows", "corner": "bottom-right"}, [[4, 5, 6], [3, 2, 1]]),
        ({"columns": 2, "order": "snake-rows", "corner": "top-right"}, [[2, 1], [3, 4], [6, 5]]),
        ({"columns": 3, "mirror": "x"}, [[3, 2, 1], [6, 5, 4]]),
        ({"columns": 3, "mirror": "both"}, [[6, 5, 4], [3, 2, 1]]),
    ],
)
def test_running_numbers_go_along_the_lines_from_the_corner(tiles, tmp_path, given, right):
    dataset = import_dataset(tiles, tmp_path / "a.wafer", pattern="tile_{n}.tif", **LENGTHS, **given)
    assert grid(dataset) == right
    xs, ys = ({getattr(f, axis) for f in dataset.fields} for axis in ("x_um", "y_um"))
    assert np.diff(sorted(xs)) == pytest.approx(WIDTH_UM)
    assert len(ys) == 1 or np.diff(sorted(ys)) == pytest.approx(HEIGHT_UM)


def test_a_missing_tile_leaves_its_place_empty(tiles, tmp_path):
    (tiles / "tile_05.tif").unlink()
    given = LENGTHS | {"columns": 3, "order": "snake-rows"}
    assert grid(import_dataset(tiles, tmp_path / "a.wafer", pattern="tile_{n}.tif", **given)) == [[1, 2, 3], [6, 0, 4]]


def test_an_order_without_the_number_of_columns_is_refused(tiles, tmp_path):
    with pytest.raises(DatasetError, match="--columns"):
        import_dataset(tiles, tmp_path / "a.wafer", pattern="tile_{series:2}.tif", order="snake-rows", **LENGTHS)


AT = {n: (7.0 * ((n - 1) % 3) + 0.25 * n, -5.0 * ((n - 1) // 3)) for n in range(1, 7)}
"""Places on the stage in um, y up."""


def fiji(n, x, y):
    return f"tile_{n:02d}.tif; ; ({2 * x}, {-2 * y})"


def mist(n, x, y):
    return f"file: tile_{n:02d}.tif; corr: 0.99; position: ({2 * x:.0f}, {-2 * y:.0f}); grid: (0, 0);"


def pos_2():
    def one(n, x, y):
        devices = {"array": [{"Position_um": {"array": [3.0]}}, {"Position_um": {"array": [x, y]}}]}
        return {"Label": {"scalar": f"tile_{n:02d}"}, "DevicePositions": devices}

    return json.dumps({"map": {"StagePositions": {"array": [one(n, *at) for n, at in AT.items()]}}})


def pos_1():
    devices = [{"AXES": 1, "X": 3.0, "Y": 0.0}]
    return json.dumps(
        {
            "POSITIONS": [
                {"LABEL": f"tile_{n:02d}", "DEVICES": [*devices, {"AXES": 2, "X": x, "Y": y}]}
                for n, (x, y) in AT.items()
            ]
        }
    )


TABLES = {
    "TileConfiguration.txt": lambda: "# Fiji\ndim = 2\n\n" + "\n".join(fiji(n, *at) for n, at in AT.items()),
    "global-positions-0.txt": lambda: "\n".join(mist(n, *at) for n, at in AT.items()),
    "a.pos": pos_2,
    "old.pos": pos_1,
    "um.csv": lambda: "file,x_um,y_um\n" + "\n".join(f"tile_{n:02d}.tif,{x},{y}" for n, (x, y) in AT.items()),
    "mm.csv": lambda: (
        "Name;X [mm];Y [mm]\n"
        + "\n".join(f"tile_{n:02d};{x / 1000:.6f};{y / 1000:.6f}".replace(".", ",") for n, (x, y) in AT.items())
    ),
    "px.csv": lambda: "tile\tx_px\ty_px\n" + "\n".join(f"tile_{n:02d}\t{2 * x}\t{-2 * y}" for n, (x, y) in AT.items()),
}


@pytest.mark.parametrize("name", TABLES)
def test_a_table_says_where_the_fields_lie(tiles, tmp_path, name):
    (tmp_path / name).write_text(TABLES[name]())
    dataset = import_dataset(tiles, tmp_path / "a.wafer", places=tmp_path / name, **LENGTHS)
    assert grid(dataset) == [[1, 2, 3], [4, 5, 6]]
    tolerance = 0.3 if name.startswith("global") else 1e-6  # MIST writes whole pixels
    for field in dataset.fields:
        n = int(dataset.stack(field.number, verify=False).images[0, 0, 0])
        assert (field.x_um, field.y_um) == pytest.approx(AT[n], abs=tolerance)


def test_a_table_by_number_places_the_fields_of_a_pattern_and_the_command_mirrors_them(tiles, tmp_path):
    (tmp_path / "a.csv").write_text("n,x_um,y_um\n" + "\n".join(f"{n},{x},{y}" for n, (x, y) in AT.items()))
    words = ["--pattern", "tile_{n}.tif", "--places", str(tmp_path / "a.csv"), "--mirror", "x"]
    lengths = ["--z-step-um", "2", "--pixel-um", "0.5"]
    assert main(["import", str(tiles), *words, *lengths, "-o", str(tmp_path / "a.wafer")]) == 0
    from wafer_viewer.store.dataset.dataset import Dataset

    assert grid(Dataset.open(tmp_path / "a.wafer")) == [[3, 2, 1], [6, 5, 4]]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("file,x_um,y_um\ntile_01.tif,0,0\n", "no place for tile_02.tif"),
        ("file,x,y\ntile_01.tif,0,0\n", "'x_um' and 'y_um'"),
        ("file,x_um,y_um\ntile_01.tif,0\n", "line 2"),
        ("file,x_um,y_um\ntile_01.tif,0,0\ntile_01.tif,1,0\n", "two places for tile_01.tif"),
        ('{"a": 1}', "no position list"),
    ],
)
def test_a_table_that_leaves_something_open_is_refused(tiles, tmp_path, text, words):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(DatasetError, match=words):
        import_dataset(tiles, tmp_path / "a.wafer", places=tmp_path / "a.csv", **LENGTHS)
    assert not (tmp_path / "a.wafer").exists()
