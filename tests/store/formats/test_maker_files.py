"""Surface files of instrument makers, written here by hand, read by SurfaceTopography."""

from __future__ import annotations

import contextlib
import struct
import sys
import warnings
import zlib

import numpy as np
import pytest
import scipy.io

from wafer_viewer.cli.app import main
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.maker_formats import MAKER_FILES
from wafer_viewer.store.formats.conversion import read_surface

Z = 0.1 * np.arange(30.0)[None, :] + 0.02 * np.arange(20.0)[:, None] ** 2
"""Heights in um; no row and no column is as another."""
GAPS = np.zeros(Z.shape, bool)
GAPS[3:6, 4:9] = True
KNOWN = np.where(GAPS, np.nan, Z)


@pytest.fixture
def library():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return pytest.importorskip("SurfaceTopography", reason="pip install 'wafer-viewer[surfaces]'")


def al3d(z_um=KNOWN, pixel_um=0.5):
    tags = {"Version": 1, "TagCount": 7, "Cols": 30, "Rows": 20, "InvalidPixelValue": "1e10", "NumberOfPlanes": 1}
    tags |= {"PixelSizeXMeter": f"{pixel_um}e-6", "PixelSizeYMeter": f"{pixel_um}e-6", "DepthImageOffset": 1000}
    head = b"AliconaImaging\0\r\n"
    for name, value in tags.items():
        head += name.encode().ljust(20, b"\0") + str(value).encode().ljust(30, b"\0") + b"\r\n"
    return head.ljust(1000, b"\0") + np.where(GAPS, 1e10, z_um * 1e-6).astype("<f4").tobytes()


def sdf_text():
    words = np.where(GAPS, "BAD", np.round(Z * 1000).astype(int).astype(str))
    names = ("ManufacID = X", "NumPoints = 30", "NumProfiles = 20", "Xscale = 5e-7", "Yscale = 5e-7", "Zscale = 1e-9")
    head = ("aISO-1.0", *names, "Zresolution = -1", "Compression = 0", "DataType = 7", "CheckType = 0", "*")
    return "\r\n".join((*head, *(" ".join(row) for row in words), "*")).encode()


def sdf_binary():
    head = struct.pack("<8s10s12s12sHHddddBBB", b"bISO-1.0", b"X", b"", b"", 30, 20, 5e-7, 5e-7, 1e-9, -1, 0, 5, 0)
    return head + np.where(GAPS, -32768, np.round(Z * 1000)).astype("<i2").tobytes()


def sur(kind=2, *, packed=False, rows=20, zmin=0, zmax=None, inversion=0):
    """Write 16-bit heights in nm, pixels in mm; gaps are two below the lowest height."""
    counts = np.where(GAPS, zmin - 2, np.round(Z * 1000))[:rows].astype("<i2")
    head = struct.pack("<12s4H30s30s", b"DSCOMPRESSED" if packed else b"DIGITAL SURF", 0, 1, 1, kind, b"", b"")
    head += struct.pack("<5HIIH", 0, 0, 0, 1, 0, 0, 0, 16)
    head += struct.pack(
        "<4iI3f", zmin, round(Z.max() * 1000) if zmax is None else zmax, 30, rows, 30 * rows, 5e-4, 5e-4, 1.0
    )
    for text in ("X", "Y", "Z", "mm", "mm", "nm", "mm", "mm", "nm"):
        head += text.encode().ljust(16, b"\0")
    head += struct.pack("<3f3H", 1, 1, 1, 0, inversion, 0)
    head = head.ljust(334, b"\0") + struct.pack("<2H", 4, 0)
    data = counts.tobytes()
    if packed:
        parts = [(data[:500], zlib.compress(data[:500])), (data[500:], zlib.compress(data[500:]))]
        data = struct.pack("<I", 2) + b"".join(struct.pack("<2I", len(raw), len(small)) for raw, small in parts)
        data += b"".join(small for _, small in parts)
    return head.ljust(512, b"\0") + b"note" + data


def nms(zmin=1.0, zmax=11.0):
    """Write 16-bit heights between 1 and 11 um; pixels of 312.5 nm."""
    head = bytearray(3468)
    struct.pack_into("<2d", head, 16, zmin, zmax)
    struct.pack_into("<2I2d", head, 1368, 30, 20, 312.5, 312.5)
    return bytes(head) + np.round((Z - 1) / 10 * 65534).clip(0).astype("<u2").tobytes()


FILES = {
    "a.al3d": (al3d, 0.5, 1e-6),
    "text.sdf": (sdf_text, 0.5, 6e-4),
    "binary.sdf": (sdf_binary, 0.5, 6e-4),
    "a.sur": (sur, 0.5, 6e-4),
    "packed.sur": (lambda: sur(packed=True), 0.5, 6e-4),
    "gwyddion.sur": (lambda: sur(1), 0.5, 6e-4),
    "al3d.x3p": (al3d, 0.5, 1e-6),
    "sdf.txt": (sdf_text, 0.5, 6e-4),
    "sur.bin": (sur, 0.5, 6e-4),
}


@pytest.mark.parametrize("name", FILES)
def test_heights_gaps_pixels_and_orientation(tmp_path, library, name):
    made, pixel_um, atol = FILES[name]
    (tmp_path / name).write_bytes(made())
    back = read_surface(tmp_path / name)
    np.testing.assert_array_equal(np.isnan(back.z_um), GAPS)
    np.testing.assert_allclose(back.z_um, KNOWN, atol=atol)
    assert back.pixel_um == pytest.approx(pixel_um)
    assert back.provenance.calibration is None
    assert "SurfaceTopography read it as" in " ".join(back.provenance.notes)
    assert ("not its ending" in " ".join(back.provenance.notes)) == (name in ("al3d.x3p", "sdf.txt", "sur.bin"))


def test_the_pixels_of_nms_are_nanometres(tmp_path, library):
    """SurfaceTopography takes them for millimetres: a field of 9 m."""
    (tmp_path / "a.nms").write_bytes(nms())
    back = read_surface(tmp_path / "a.nms")
    assert back.pixel_um == pytest.approx(0.3125)
    np.testing.assert_allclose(back.z_um, Z.clip(1), atol=1e-4)


def test_a_matrix_of_matlab_has_its_first_row_on_top(tmp_path, library):
    """Shown as MATLAB's imagesc does; it has no units, which are asked for."""
    scipy.io.savemat(tmp_path / "a.mat", {"z": KNOWN, "n": 7})
    with pytest.raises(DatasetError, match="states no pixel size: give it, as in --pixel-um"):
        read_surface(tmp_path / "a.mat", z_unit="um")
    back = read_surface(tmp_path / "a.mat", z_unit="um", pixel_um=0.5)
    np.testing.assert_allclose(back.z_um, KNOWN, atol=1e-6)
    assert "The first row of its matrix 'z' was taken as the top edge" in " ".join(back.provenance.notes)


def test_a_mean_of_76_mm_costs_no_nanometres(tmp_path, library):
    (tmp_path / "a.al3d").write_bytes(al3d(Z + 76_000))
    back = read_surface(tmp_path / "a.al3d")
    assert "were taken off its heights" in " ".join(back.provenance.notes)
    steps = np.diff(back.z_um[10])
    np.testing.assert_allclose(steps[np.isfinite(steps)], 0.1, atol=0.0076)  # the file itself has steps of 7.5 nm
    assert abs(back.z_um[19, 29]) < 10


@pytest.mark.parametrize(
    ("name", "content", "given", "sentence"),
    [
        ("zeros.al3d", b"\0" * 64, {}, "cannot be read as Alicona AL3D"),
        ("cut.al3d", al3d()[:2000], {}, "cannot be read as Alicona AL3D"),
        ("cut.sur", sur()[:800], {}, "cannot be read as Digital Surf SUR"),
        ("cut.sur", sur(packed=True)[:700], {}, "cannot be read as Digital Surf SUR"),
        ("zeros.dat", b"\0" * 64, {}, "cannot be read as Zygo MetroPro DAT"),
        ("a.pro", sur(1, rows=1), {}, "holds profiles or an image and no surface"),
        ("image.sur", sur(9), {}, "holds profiles or an image and no surface"),
        ("a.al3d", al3d(pixel_um=50_000), {}, "gives pixels of 50000 x 50000 um, as no microscope has"),
        ("a.al3d", al3d(), {"pixel_um": 2}, "states pixels of 0.5 um, but --pixel-um is 2"),
        ("a.sur", sur(zmin=5000), {}, "states heights from 5000 to 10120 nm in its header, and has 0 to 10120 nm"),
        ("a.sur", sur(zmax=9000), {}, "states heights from 0 to 9000 nm in its header, and has 0 to 10120 nm"),
        (
            "a.sur",
            sur(inversion=1, zmax=9000),
            {},
            "states heights from -9000 to 0 nm in its header, and has -10120 to",
        ),
        ("a.nms", nms(11, 1), {}, r"states heights from 11 to 1 µm in its header, and has 1\.\d* to 11 µm"),
        ("a.al3d", al3d(), {"z_unit": "mm"}, "states heights in m, but --z-unit is mm"),
    ],
)
def test_what_cannot_be_read_is_one_sentence(tmp_path, library, name, content, given, sentence):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(DatasetError, match=rf"^{name} {sentence}.*\.$") as fault:
        read_surface(tmp_path / name, **given)
    assert str(fault.value).count(". ") == 0
    assert str(fault.value).isprintable()


@pytest.mark.parametrize("name", ["a.al3d", "text.sdf", "binary.sdf", "a.sur", "packed.sur", "a.nms"])
def test_damage_ends_in_one_sentence_or_a_surface(tmp_path, library, name):
    good, rng = (nms if name == "a.nms" else FILES[name][0])(), np.random.default_rng(7)
    for _ in range(40):
        content = bytearray(good[: rng.integers(len(good))] if rng.random() < 0.5 else good)
        for at in rng.integers(0, max(1, min(len(content), 1500)), 4):
            content[at : at + 1] = bytes([rng.integers(256)])
        (tmp_path / name).write_bytes(content)
        with contextlib.suppress(DatasetError):
            assert read_surface(tmp_path / name).z_um.ndim == 2


def test_doubts_are_notes(tmp_path, library):
    (tmp_path / "steep.al3d").write_bytes(al3d(Z * 1000))
    assert "check its units" in " ".join(read_surface(tmp_path / "steep.al3d").provenance.notes)


def test_text_with_the_ending_of_a_maker_is_text(tmp_path):
    np.savetxt(tmp_path / "a.dat", Z)
    np.testing.assert_allclose(read_surface(tmp_path / "a.dat", "um", 1).z_um, Z, atol=1e-6)


@pytest.mark.parametrize("kind", MAKER_FILES, ids=lambda kind: kind.reader)
def test_without_the_extra_the_kind_and_the_remedy_are_named(tmp_path, monkeypatch, capsys, kind):
    for name in ("SurfaceTopography", "SurfaceTopography.IO"):
        monkeypatch.setitem(sys.modules, name, None)
    path = tmp_path / f"a{kind.suffixes[0]}"
    path.write_bytes(b"".join(kind.magic[:1]).ljust(64, b"\0"))
    assert main(["convert", str(path), str(tmp_path / "b.npz")]) == 2
    words = capsys.readouterr().err
    assert f"a {kind.title} file" in words.replace("an ", "a ")
    assert "pip install 'wafer-viewer[surfaces]'" in words


def test_the_readers_are_there(library):
    from SurfaceTopography.IO import lookup_reader_by_format

    assert {kind.reader for kind in MAKER_FILES} <= lookup_reader_by_format.keys()


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(
    ("ending", "options"), [(".al3d", {}), (".sdf", {}), (".sdf", {"binary": False}), (".sur", {"compressed": True})]
)
def test_files_that_surfalize_writes(tmp_path, library, ending, options):
    surfalize = pytest.importorskip("surfalize", reason="pip install surfalize")
    surfalize.Surface(KNOWN, 0.5, 0.5).save(str(tmp_path / f"a{ending}"), **options)
    back = read_surface(tmp_path / f"a{ending}")
    assert back.pixel_um == pytest.approx(0.5)
    np.testing.assert_allclose(back.z_um[~GAPS], Z[~GAPS], atol=2e-4)
    assert np.isnan(back.z_um[GAPS]).all()
