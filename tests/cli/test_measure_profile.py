from __future__ import annotations

import io
import json

import numpy as np
import pytest
from PIL import Image

from tests.support.surfaces import coordinates, surface_of
from wafer_viewer.cli.app import main
from wafer_viewer.store.formats.npz_file import write_npz


@pytest.fixture(scope="module")
def tilted(tmp_path_factory):
    """A surface file of 60 rows and 80 columns, half a micrometre apart: z = 0.3 x - 0.2 y, a row unmeasured."""
    x_um, y_um = np.meshgrid(*coordinates(60, 80))
    z = 0.3 * x_um - 0.2 * y_um
    cleaned = z.copy()
    z[:, 20:30] = np.nan
    path = tmp_path_factory.mktemp("cut") / "tilted.npz"
    write_npz(surface_of(cleaned, z, np.where(np.isfinite(z), 0, 1).astype(np.uint8), simulated=True), path)
    return path


def reported(capsys, *argv):
    assert main(["measure", "profile", *map(str, argv)]) == 0
    return json.loads(capsys.readouterr().out)


def test_one_line_is_one_answer(tilted, capsys):
    found = reported(capsys, tilted, "--line", -15, 0, 15, 0, "--width-um", 2)
    assert found["pt"]["value_um"] == pytest.approx(9.0, abs=0.01)
    assert found["filter"] == "mean over 2 um across the line"
    assert found["measured_fraction"] < 0.9


def test_a_polyline_has_arc_lengths_and_names_its_corners_in_the_table(tilted, capsys, tmp_path):
    found = reported(
        capsys, tilted, "--polyline", -15, 5, 5, 5, 5, 10, "--width-um", 1, "--points", "-o", tmp_path / "path.csv"
    )
    assert found["line"]["kind"] == "polyline"
    assert found["length_um"] == found["points"]["distance_um"][-1] == pytest.approx(25.0)
    assert found["rise"]["value_um"] == pytest.approx(0.3 * 20 - 0.2 * 5, abs=1e-3)
    assert "from (-15.00, 5.00) by 1 corner to (5.00, 10.00) um" in (tmp_path / "path.csv").read_text()


def test_rows_and_columns_are_cut_by_number_from_edge_to_edge(tilted, capsys):
    row, column = reported(capsys, tilted, "--row", 0, "--column", 79, "--points")
    assert row["line"]["points"] == [[-19.75, 14.75], [19.75, 14.75]]
    assert len(row["points"]["z_um"]) == 80
    assert len(column["points"]["z_um"]) == 60
    assert column["rise"]["value_um"] == pytest.approx(0.2 * 29.5, abs=1e-3)


def test_raw_and_cleaned_heights_are_two_curves_of_one_line(tilted, capsys):
    raw, cleaned = reported(capsys, tilted, "--row", 30, "--cleaned")
    assert (raw["curve"], cleaned["curve"]) == ("A", "A filtered and filled heights")
    assert raw["measured_fraction"] < cleaned["measured_fraction"] == 1.0


def test_heights_are_read_from_another_zero(tilted, capsys, tmp_path):
    flat = reported(capsys, tilted, "--row", 30, "--level", "plane", "-o", tmp_path / "flat.csv")
    assert flat["pt"]["value_um"] == pytest.approx(0.0, abs=1e-3)
    assert flat["levelling"]["by"] == "plane"
    text = (tmp_path / "flat.csv").read_text()
    assert "levelled by plane" in text
    assert "SIMULATED" in text


@pytest.mark.slow
def test_figures_and_a_table_are_written_of_several_lines(tilted, capsys, tmp_path):
    for name in ("cuts.png", "cuts.pdf", "cuts.svg", "cuts.csv"):
        reported(capsys, tilted, "--line", -15, 0, 15, 0, -15, 5, 15, 5, "--column", 10, "-o", tmp_path / name)
    assert Image.open(io.BytesIO((tmp_path / "cuts.png").read_bytes())).size == (2008, 1063)
    assert (tmp_path / "cuts.pdf").read_bytes().startswith(b"%PDF")
    drawn = (tmp_path / "cuts.svg").read_text()
    assert all(words in drawn for words in ("z, µm", "Distance along the profile, µm", ">SIMULATED<"))
    heads = next(line for line in (tmp_path / "cuts.csv").read_text().splitlines() if not line.startswith("#"))
    assert [heads.count(f"{letter} z_um") for letter in "ABCD"] == [1, 1, 1, 0]


@pytest.mark.parametrize(
    ("flags", "sentence"),
    [
        (("--row", 60), "There is no row 60: the surface has the rows 0 to 59."),
        (("--line", 1, 2, 3), "--line has 3 numbers: give X0 Y0 X1 Y1 for each line."),
        (("--polyline", 1, 2, 3), "--polyline has 3 numbers: give X Y of each of its points, at least two."),
        ((), "0 lines are asked for: give 1 to 4"),
        (("--row", 1, 2, 3, 4, 5), "5 lines are asked for: give 1 to 4"),
        (("--row", 1, "-o", "cut.xls"), "Profiles cannot be written as '.xls': use .csv, .png, .pdf or .svg."),
    ],
)
def test_what_cannot_be_cut_is_one_sentence(tilted, capsys, tmp_path, monkeypatch, flags, sentence):
    monkeypatch.chdir(tmp_path)
    assert main(["measure", "profile", str(tilted), *map(str, flags)]) == 2
    assert sentence in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_another_surface_that_does_not_reach_the_line_is_named(tilted, capsys, tmp_path):
    far = surface_of(np.zeros((20, 20)))
    write_npz(far, tmp_path / "small.npz")
    assert main(["measure", "profile", str(tilted), "--column", "0", "--other", str(tmp_path / "small.npz")]) == 2
    assert "small has no heights along line A." in capsys.readouterr().err
