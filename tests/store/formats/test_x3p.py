"""X3P files of other programs and of this one."""

from __future__ import annotations

import hashlib
import zipfile

import numpy as np
import pytest

from tests.support.datasets.samples import make_surface
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.formats.conversion import export, read_surface

Z = 0.1 * np.arange(30.0)[None, :] + 0.2 * np.arange(20.0)[:, None] ** 1.5
"""Heights in um; no row and no column is as another."""
BIN = "<PointDataLink>bindata/data.bin</PointDataLink>"


def x3p(
    path, data, link=f"<DataLink>{BIN}</DataLink>", kind="D", dx=1e-6, dy=1e-6, z="", folder="", more=(), creator="M"
):
    """Write an X3P file of another program; data: bytes of the heights."""
    axes = "".join(
        f"<C{n}><AxisType>{t}</AxisType><DataType>{d}</DataType>{i}</C{n}>"
        for n, t, d, i in (
            ("X", "I", "D", f"<Increment>{dx!r}</Increment><Offset>0</Offset>"),
            ("Y", "I", "D", f"<Increment>{dy!r}</Increment><Offset>0</Offset>"),
            ("Z", "A", kind, z),
        )
    )
    xml = (
        '<p:ISO5436_2 xmlns:p="http://www.opengps.eu/2008/ISO5436_2"><Record1><Revision>ISO5436 - 2000</Revision>'
        f"<FeatureType>SUR</FeatureType><Axes>{axes}</Axes></Record1><Record2><Creator>{creator}</Creator></Record2>"
        f"<Record3><MatrixDimension><SizeX>30</SizeX><SizeY>20</SizeY><SizeZ>1</SizeZ></MatrixDimension>{link}"
        "</Record3></p:ISO5436_2>"
    ).encode()
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(f"{folder}main.xml", xml)
        archive.writestr(f"{folder}md5checksum.hex", hashlib.md5(xml).hexdigest() + " *main.xml\n")
        for name, content in (("bindata/data.bin", data), *more):
            archive.writestr(folder + name, content)
    return path


def doubles(z_um=Z):
    return (z_um * 1e-6).astype("<f8").tobytes()


@pytest.mark.parametrize("folder", ["", "sample/", "a/b/"])
def test_first_row_is_top_edge(tmp_path, folder):
    back = read_surface(x3p(tmp_path / "a.x3p", doubles(), folder=folder))
    np.testing.assert_allclose(back.z_um, Z, atol=1e-6)
    assert (back.x0_um, back.y0_um, back.pixel_um) == pytest.approx((0, 0, 1))


def test_file_written_bottom_row_first_is_refused(tmp_path):
    path = x3p(tmp_path / "a.x3p", doubles(), creator="Wafer Viewer")
    with pytest.raises(DatasetError, match=r"a\.x3p begins with the bottom row, .* export its surface again"):
        read_surface(path)


def test_exported_surface_keeps_its_place(tmp_path):
    export(surface := make_surface(x0_um=3.0, y0_um=700.0), path := tmp_path / "a.x3p")
    back = read_surface(path)
    np.testing.assert_array_equal(back.z_um, surface.z_um)
    assert (back.x0_um, back.y0_um) == pytest.approx((3, 700))


@pytest.mark.parametrize("program", ["SurfaceTopography", "surfalize"])
@pytest.mark.filterwarnings("ignore")
def test_files_are_upright_both_ways(tmp_path, program):
    """What we write they show as it is; what they write we read as it is."""
    library = pytest.importorskip(program, reason=f"pip install {program}")
    export(surface := make_surface(), tmp_path / "a.x3p")
    if program == "surfalize":
        other = library.Surface.load(str(tmp_path / "a.x3p"))
        heights = other.data
        other.save(str(tmp_path / "b.x3p"))
    else:
        other = library.read_topography(str(tmp_path / "a.x3p"))
        heights = np.ma.filled(other.heights().T, np.nan) * 1e6
        other.to_x3p(str(tmp_path / "b.x3p"))
    np.testing.assert_allclose(heights, surface.z_um, atol=1e-6)
    with zipfile.ZipFile(tmp_path / "b.x3p") as archive, zipfile.ZipFile(tmp_path / "c.x3p", "w") as anew:
        for name in archive.namelist():
            if name != "md5checksum.hex":  # of the heights, not of main.xml, in SurfaceTopography
                anew.writestr(name, archive.read(name))
    np.testing.assert_allclose(read_surface(tmp_path / "c.x3p").z_um, surface.z_um, atol=1e-5)


@pytest.mark.parametrize(("kind", "dtype"), [("I", "<i2"), ("L", "<i4"), ("F", "<f4"), ("D", "<f8")])
def test_all_data_types(tmp_path, kind, dtype):
    """Integers with an increment, an offset and a mask of valid points; floats with NaN."""
    z, gaps = Z.copy(), np.zeros(Z.shape, bool)
    gaps[3:6, 4:9] = True
    if dtype[1] == "i":
        data = np.round((z - 5) / 0.001).astype(dtype)
        scale = "<Increment>1e-09</Increment><Offset>5e-06</Offset>"
        valid = "<ValidPointsLink>bindata/valid.bin</ValidPointsLink>"
        more = [("bindata/valid.bin", np.packbits(~gaps.ravel(), bitorder="little").tobytes())]
    else:
        data, scale, valid, more = np.where(gaps, np.nan, z * 1e-6).astype(dtype), "", "", []
    link = f"<DataLink>{BIN}{valid}</DataLink>"
    back = read_surface(x3p(tmp_path / "a.x3p", data.tobytes(), link, kind, z=scale, more=more))
    np.testing.assert_array_equal(np.isnan(back.z_um), gaps)
    np.testing.assert_allclose(back.z_um[~gaps], z[~gaps], atol=5e-4 if dtype[1] == "i" else 1e-5)


def test_heights_as_text(tmp_path):
    texts = [f"{z * 1e-6!r}" for z in Z.ravel().tolist()]
    texts[7], texts[8] = "", "7e-06;0;5e-06"
    listed = "".join(f"<Datum>{text}</Datum>" for text in texts)
    back = read_surface(x3p(tmp_path / "a.x3p", b"", f"<DataList>{listed}</DataList>"))
    assert np.isnan(back.z_um[0, 7])
    assert back.z_um[0, 8] == 5
    np.testing.assert_allclose(back.z_um[1:], Z[1:], atol=1e-6)


def test_nearly_square_pixels_are_kept_with_a_note(tmp_path):
    back = read_surface(x3p(tmp_path / "a.x3p", doubles(), dx=3.678887926e-6, dy=3.680270397e-6))
    np.testing.assert_allclose(back.z_um, Z, atol=1e-6)
    assert back.pixel_um == pytest.approx(3.678887926)
    assert "y is short by 0.026 um" in " ".join(back.provenance.notes)


@pytest.mark.parametrize(("dx", "dy"), [(1, 2), (2, 1), (1, 1.7)])
def test_oblong_pixels_are_resampled_with_a_note(tmp_path, dx, dy):
    """A plane stays the plane, on all of the surface; a gap becomes no smaller; measured heights stay themselves."""
    x, y = np.arange(30)[None] * dx, np.arange(20)[:, None] * dy
    z = 0.1 * x + 0.03 * y
    z[8, 10] = np.nan
    back = read_surface(x3p(tmp_path / "a.x3p", doubles(z), dx=dx * 1e-6, dy=dy * 1e-6))
    assert back.pixel_um == pytest.approx(1)
    assert back.shape == (int(19 * dy + 1e-9) + 1, int(29 * dx + 1e-9) + 1)
    rows, cols = np.indices(back.shape)
    known = np.isfinite(back.z_um)
    np.testing.assert_allclose(back.z_um[known], (0.1 * cols + 0.03 * rows)[known], atol=1e-5)
    assert not known[round(8 * dy), round(10 * dx)]
    assert 1 <= (~known).sum() <= 4
    assert f"no detail along {'x' if dx > dy else 'y'} is finer than {max(dx, dy)} um" in " ".join(
        back.provenance.notes
    )


def test_large_mean_is_taken_off_before_rounding(tmp_path):
    """76 mm above a table in 64-bit floats: 32-bit ones would round to 8 nm."""
    back = read_surface(x3p(tmp_path / "a.x3p", doubles(Z * 1e-3 + 76_000.0)))
    assert "76000 um were taken off its heights" in " ".join(back.provenance.notes)
    np.testing.assert_allclose(back.z_um, Z * 1e-3, atol=1e-6)
