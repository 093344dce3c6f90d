"""Matrices of heights as text, and points, with the separators, headers and words for gaps of other programs."""

from __future__ import annotations

import numpy as np
import pytest

from wafer_viewer.cli.app import main
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.formats.conversion import read_surface

Z = 0.1 * np.arange(30.0)[None, :] + 0.2 * np.arange(20.0)[:, None] ** 1.5
GAP = (slice(5, 8), slice(9, 13))
"""In cases with gaps; never in the first line alone."""


def write(path, z=Z, between=",", header="", word=None, comma=False, end="", quote="", encoding="utf-8"):
    """Write a matrix; word: the text of its gaps."""
    cells = [[format(v, ".4f").replace(".", "," if comma else ".") for v in row] for row in z.tolist()]
    if word is not None:
        for row in cells[GAP[0]]:
            row[GAP[1]] = [word] * 4
    lines = [between.join(f"{quote}{cell}{quote}" for cell in row) + end for row in cells]
    path.write_bytes((header + "\n".join(lines) + "\n").encode(encoding))
    return path


def assert_is(surface, z=Z, *, gaps=False):
    expected = z.copy()
    if gaps:
        expected[GAP] = np.nan
    np.testing.assert_allclose(surface.z_um, expected, atol=1e-4)


@pytest.mark.parametrize("ending", [".csv", ".txt", ".asc"])
@pytest.mark.parametrize(
    "form",
    [
        {},
        {"between": ";", "comma": True},
        {"between": "\t", "end": "\t"},
        {"between": "   "},
        {"between": " ", "comma": True},
        {"between": ", ", "quote": '"'},
        {"encoding": "utf-16"},
        {"encoding": "utf-8-sig", "between": ";"},
        {"header": "Höhen, Messung 3\n\n", "encoding": "latin-1"},
    ],
    ids=str,
)
def test_separators_decimal_commas_and_encodings(tmp_path, ending, form):
    back = read_surface(write(tmp_path / f"a{ending}", **form), z_unit="um", pixel_um=0.5)
    assert_is(back)
    assert back.pixel_um == 0.5
    assert "20 rows of 30 heights" in " ".join(back.provenance.notes)


@pytest.mark.parametrize("word", ["Bad", "***", "", "NaN", "N/A", "#N/A", "-", "--", "1.#QNAN", "null"])
@pytest.mark.parametrize("form", [{}, {"between": ";", "comma": True, "end": ";"}], ids=str)
def test_words_for_gaps(tmp_path, word, form):
    assert_is(read_surface(write(tmp_path / "a.csv", word=word, **form), z_unit="um", pixel_um=1), gaps=True)
    points = [
        f"{j},{-i},{word if 5 <= i < 8 and 9 <= j < 13 else format(Z[i, j], '.4f')}" for i, j in np.ndindex(Z.shape)
    ]
    (tmp_path / "b.csv").write_text("x_um,y_um,z_um\n" + "\n".join(points))
    assert_is(read_surface(tmp_path / "b.csv"), gaps=True)


@pytest.mark.parametrize("number", ["-9999", "-32768", "1e10", "3.40282346e+38", "-1e30"])
def test_repeated_numbers_far_beyond_the_heights_are_gaps(tmp_path, number):
    back = read_surface(write(tmp_path / "a.txt", word=number, between="\t"), z_unit="um", pixel_um=1)
    assert_is(back, gaps=True)
    assert f"12 of its values are {float(number):g}, far beyond" in " ".join(back.provenance.notes)


def test_a_number_that_may_be_a_height_stays_with_a_note(tmp_path):
    z = Z * 2000
    z[3, 4] = z[7, 9] = 9999
    back = read_surface(write(tmp_path / "a.txt", z, " "), z_unit="nm", pixel_um=1)
    assert_is(back, z / 1000)
    assert "2 of its heights are exactly 9999" in " ".join(back.provenance.notes)


HEADERS = {
    "gwyddion": "# Channel: Z\n# Width: 15.0 µm\n# Height: 10000 nm\n# Value units: nm\n",
    "german": "# Kanal: Z\n# Breite: 15,0 µm\n# Höhe: 10,0 µm\n# Value units: nm\n",
    "keyence": '"Date","2024-05-06 07:08"\n'
    '"XY calibration","500","nm/pixel"\n"Horizontal","30"\n"Vertical","20"\n"Unit","nm"\n',
    "assigned": "h=20 w=30\npixel size=5e-007 m\ndata unit=nm\n",
    "named": "ncols 30\nnrows 20\ndx (um): 0.5\ndy (um): 0.5\nz unit: nm\nNODATA_value 7777\n",
}


@pytest.mark.parametrize("name", HEADERS)
def test_headers_state_pixel_size_and_unit(tmp_path, name):
    z, comma = Z * 1000, name == "german"
    word = "7777" if name == "named" else None
    path = write(tmp_path / "a.txt", z, "\t", HEADERS[name], word, comma)
    back = read_surface(path)
    assert_is(back, gaps=name == "named")
    assert back.pixel_um == pytest.approx(0.5)
    with pytest.raises(DatasetError, match=r"states pixels of 0.5 um, but --pixel-um is 2"):
        read_surface(path, pixel_um=2)


@pytest.mark.parametrize(
    ("content", "given", "sentence"),
    [
        ({}, {}, "states no unit of its heights: give it, as in --z-unit um"),
        ({}, {"z_unit": "um"}, "states no pixel size: give it, as in --pixel-um 0.5"),
        ({"header": "ncols 31\n"}, {"z_unit": "um", "pixel_um": 1}, "states 31 cols and has 30"),
        (
            {"word": "three"},
            {"z_unit": "um", "pixel_um": 1},
            "has lines without numbers, such as 'three', which is no word for a gap",
        ),
        ({"word": "1,2"}, {"z_unit": "um", "pixel_um": 1}, "has lines of 30 and of 34 values"),
        ({"header": "Wyko ASCII Data File Format 0 1\n"}, {}, "is a Wyko ASCII file"),
        (
            {"header": "," + ",".join(f"{0.5 * n}" for n in range(29)) + "\n", "z": np.c_[np.arange(20), Z[:, :29]]},
            {"z_unit": "um", "pixel_um": 1},
            "has coordinates in its first line and column",
        ),
    ],
)
def test_what_is_not_sure_is_refused_with_the_mend(tmp_path, content, given, sentence):
    with pytest.raises(DatasetError, match=rf"^a\.csv {sentence}"):
        read_surface(write(tmp_path / "a.csv", **content), **given)


def test_columns_that_may_be_points_or_heights(tmp_path, capsys):
    """Five columns without names: x, y, z, and two more; or the rows of a narrow matrix, as the user says."""
    points = [f"{j},{-i},{Z[i, j]:.4f},{i},{j}" for i, j in np.ndindex(Z.shape)]
    (tmp_path / "a.csv").write_text("\n".join(points))
    with pytest.raises(DatasetError, match="name three of them x_um, y_um and z_um"):
        read_surface(tmp_path / "a.csv", z_unit="um")
    assert_is(read_surface(tmp_path / "a.csv", z_unit="um", table="points"))
    assert read_surface(tmp_path / "a.csv", z_unit="um", pixel_um=1, table="matrix").shape == (600, 5)
    (tmp_path / "a.xyz").write_text("\n".join(points).replace(",", " "))
    assert_is(read_surface(tmp_path / "a.xyz", z_unit="um"))
    out = str(tmp_path / "a.npz")
    assert main(["convert", str(tmp_path / "a.csv"), out, "--z-unit", "um", "--table", "points"]) == 0
    assert_is(read_surface(out))
    capsys.readouterr()
    assert main(["convert", str(write(tmp_path / "b.csv")), out, "--z-unit", "um"]) == 2
    assert "--pixel-um" in capsys.readouterr().err


def test_names_in_a_comment_are_names(tmp_path):
    points = [f"{Z[i, j]:.4f} {j} {-i} 7" for i, j in np.ndindex(Z.shape)]
    (tmp_path / "a.txt").write_text("# z_um x_um y_um quality\n" + "\n".join(points))
    assert_is(read_surface(tmp_path / "a.txt"))
