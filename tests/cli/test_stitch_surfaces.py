"""Surface files that overlap become one surface, by their places, their names, or what they say."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.surfaces import height_map
from wafer_viewer.cli.app import main
from wafer_viewer.store.formats.conversion import export, read_surface

PIXEL_UM, SIDE, STEP = 0.5, 120, 100


@pytest.fixture
def tiles(tmp_path):
    """Four tiles of a rough surface, numbered along a serpentine, each at its own height; and the surface."""
    from scipy.ndimage import gaussian_filter

    rough = gaussian_filter(np.random.default_rng(5).normal(0, 8, (SIDE + STEP, SIDE + STEP)), 2).astype(np.float32)
    for n, (row, col) in enumerate([(0, 0), (0, 1), (1, 1), (1, 0)]):
        z_um = rough[row * STEP : row * STEP + SIDE, col * STEP : col * STEP + SIDE] + n
        export(height_map(z_um, pixel_um=PIXEL_UM), tmp_path / f"tile_{n}.gsf")
    return tmp_path, rough


def off_by(path, rough):
    """Standard deviation of the differences from the surface but for a plane, which overlaps leave open."""
    z_um = read_surface(path).z_um
    rows, cols = (min(a, b) for a, b in zip(z_um.shape, rough.shape, strict=True))
    assert min(rows, cols) >= SIDE + STEP - 4
    off = z_um[:rows, :cols] - rough[:rows, :cols]
    at = np.argwhere(np.isfinite(off))
    plane = np.column_stack([at, np.ones(len(at))])
    values = off[tuple(at.T)]
    return np.std(values - plane @ np.linalg.lstsq(plane, values, rcond=None)[0])


def test_running_numbers_and_tables_say_where_tiles_lie(tiles):
    folder, rough = tiles
    files = [str(folder / f"tile_{n}.gsf") for n in range(4)]
    lengths = ["--pixel-um", str(PIXEL_UM)]
    grid = ["--pattern", "tile_{n}.gsf", "--columns", "2", "--order", "snake-rows", "--overlap-fraction", "0.15"]
    assert main(["stitch-surfaces", *files, *lengths, *grid, "-o", str(folder / "a.npz")]) == 0
    assert off_by(folder / "a.npz", rough) < 0.2

    places = "\n".join(f"tile_{n}.gsf; ; ({x}, {y})" for n, (x, y) in enumerate([(0, 0), (98, 1), (101, 99), (1, 101)]))
    (folder / "TileConfiguration.txt").write_text(f"dim = 2\n{places}\n")
    table = ["--places", str(folder / "TileConfiguration.txt")]
    assert main(["stitch-surfaces", *files, *lengths, *table, "-o", str(folder / "b.npz")]) == 0
    assert off_by(folder / "b.npz", rough) < 0.2


def test_tiles_without_places_are_refused_with_what_settles_it(tiles, capsys):
    folder, _ = tiles
    files = [str(folder / f"tile_{n}.gsf") for n in range(2)]
    assert main(["stitch-surfaces", *files, "--pixel-um", "0.5", "-o", str(folder / "a.npz")]) == 2
    assert "--places" in capsys.readouterr().err
    assert main(["stitch-surfaces", *files, "--pattern", "other_{n}.gsf", "-o", str(folder / "a.npz")]) == 2
    assert "tile_0.gsf does not fit the pattern" in capsys.readouterr().err
