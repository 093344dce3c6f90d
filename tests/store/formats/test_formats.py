"""Surfaces written in each format and read back: lattice, gaps, layers, where they come from, what is said of it."""

from __future__ import annotations

import dataclasses
import errno
import math
import re
import tracemalloc
import zipfile

import numpy as np
import pytest
import tifffile

from tests.bench.big_mosaic import MadeWafer
from tests.support.datasets.samples import CALIBRATION, assert_same_surface, make_surface
from tests.support.paths import ROOT
from tests.support.surfaces import height_map
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.file_formats import READ, WRITTEN, every_for, formats_markdown
from wafer_viewer.model.surface.height_map import HeightMap, Origin
from wafer_viewer.model.surface_format import SurfaceFormat
from wafer_viewer.store.formats.conversion import density, export, is_surface_file, losses, read_surface
from wafer_viewer.store.mosaic.zarr_mosaic import write_mosaic

MESHES = (".stl", ".obj", ".glb")
BOTH = [ending for ending in WRITTEN if ending in READ and ending not in MESHES]
NEARLY = {".gsf": 2e-6, ".csv": 6e-6, ".xyz": 6e-6}
"""How far heights of some um come back off, um, in formats that do not keep all digits."""


def letter_f(**place) -> HeightMap:
    """Nothing alike in it: an F in the top left corner, a hole, a tall bottom right corner, a slope along x."""
    z = np.repeat(0.01 * np.arange(80, dtype=np.float32)[None], 60, axis=0)
    z[5:25, 5:8] += 10
    z[5:8, 5:18] += 10
    z[13:16, 5:14] += 10
    z[50:, 70:] += 40.125
    z[30:36, 40:50] = np.nan
    at = {"pixel_um": 0.46729, "x0_um": -1234.5678, "y0_um": 299_999.123, **place}
    return plain(z, **at)


def plain(z, **at) -> HeightMap:
    confidence = np.where(np.isnan(z), np.float32(0), np.float32(0.5))
    return height_map(z, grey=np.nan_to_num(z * 3).astype(np.uint8), confidence=confidence, **at)


def test_the_documentation_has_the_table_of_the_formats():
    assert formats_markdown() in (ROOT / "assets/docs/how-to/exchange-files.md").read_text()


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"suffixes": (), "reader": "a:b"}, "The suffixes of 'Mine' are"),
        ({"suffixes": ("mine",), "reader": "a:b"}, "give them as in"),
        ({"suffixes": (".MINE",), "reader": "a:b"}, "give them as in"),
        ({"suffixes": (".mine",)}, "has neither a reader nor a writer"),
    ],
)
def test_a_descriptor_that_cannot_work_is_refused(given, sentence):
    with pytest.raises(DatasetError, match=sentence):
        SurfaceFormat(title="Mine", **given)


@pytest.mark.parametrize("ending", BOTH)
def test_lattice_gaps_and_heights_come_back(tmp_path, ending):
    surface = letter_f()
    export(surface, tmp_path / f"a{ending}")
    back = read_surface(tmp_path / f"a{ending}")
    assert back.shape == surface.shape
    np.testing.assert_array_equal(np.isnan(back.z_um), np.isnan(surface.z_um))
    np.testing.assert_allclose(back.z_um, surface.z_um, atol=NEARLY.get(ending, 0), rtol=0)
    assert back.pixel_um == pytest.approx(surface.pixel_um, rel=1e-12)
    assert back.x0_um == pytest.approx(surface.x0_um, abs=1e-6)
    assert back.y0_um == pytest.approx(surface.y0_um, abs=1e-6)
    np.testing.assert_array_equal(np.isnan(back.to_measure()), np.isnan(surface.z_um))


@pytest.mark.parametrize("ending", BOTH)
def test_simulation_and_calibration_come_back(tmp_path, ending):
    export(make_surface(simulated=True, calibration=CALIBRATION, notes=("a note",)), tmp_path / f"a{ending}")
    back = read_surface(tmp_path / f"a{ending}").provenance
    assert back.simulated
    assert back.calibration == CALIBRATION
    assert back.notes[0] == "a note"
    export(make_surface(), tmp_path / f"b{ending}")
    back = read_surface(tmp_path / f"b{ending}").provenance
    assert not back.simulated
    assert back.calibration is None


def without_embedded_metadata(path):
    """Damage the machine-readable text of a file, as another program does that writes it anew."""
    if path.suffix != ".x3p":
        content = path.read_bytes()
        damaged = content.replace(b'"pixel_um"', b'"pixel_qm"').replace(
            b"&quot;pixel_um&quot;", b"&quot;pixel_qm&quot;"
        )
        assert damaged != content
        path.write_bytes(damaged)
        return
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist() if name != "md5checksum.hex"}
    main = re.sub(rb"<Comment>.*?</Comment>", b"<Comment>no remarks</Comment>", members["main.xml"], flags=re.DOTALL)
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in {**members, "main.xml": main}.items():
            archive.writestr(name, content)


@pytest.mark.parametrize("simulated", [True, False])
@pytest.mark.parametrize("ending", [ending for ending in BOTH if ending != ".npz"])
def test_simulation_comes_back_without_the_embedded_metadata(tmp_path, ending, simulated):
    path = tmp_path / f"a{ending}"
    export(make_surface(simulated=simulated, calibration=CALIBRATION), path)
    without_embedded_metadata(path)
    unit = "um" if ending in (".ply", ".pcd", ".xyz") else None
    back = read_surface(path, z_unit=unit, pixel_um=0.5)
    assert back.provenance.calibration is None
    assert back.provenance.simulated == simulated
    again = tmp_path / f"b{ending}"
    export(back, again)
    assert read_surface(again).provenance.simulated == simulated


def test_points_gridded_anew_stay_simulated(tmp_path):
    export(make_surface(simulated=True), tmp_path / "a.csv")
    without_embedded_metadata(tmp_path / "a.csv")
    back = read_surface(tmp_path / "a.csv", pixel_um=0.7)
    assert "gridded" in " ".join(back.provenance.notes)
    assert back.provenance.simulated


def test_cropped_tiff_stays_simulated(tmp_path):
    export(make_surface(simulated=True), tmp_path / "a.tif")
    with tifffile.TiffFile(tmp_path / "a.tif") as file:
        text, heights = file.pages.first.description, file.pages.first.asarray()
    tifffile.imwrite(tmp_path / "b.tif", heights[:20, :20], description=text, metadata=None)
    assert read_surface(tmp_path / "b.tif").provenance.simulated


@pytest.mark.parametrize("ending", [".npz", ".gwy"])
@pytest.mark.parametrize("grey", [np.uint8, np.uint16])
def test_formats_with_channels_keep_all_layers(tmp_path, ending, grey):
    surface = make_surface(x0_um=0.25, y0_um=-0.25, grey=grey)
    export(surface, tmp_path / f"a{ending}")
    back = read_surface(tmp_path / f"a{ending}")
    assert back.x0_um == pytest.approx(0.25, abs=1e-12)
    assert_same_surface(dataclasses.replace(back, pixel_um=0.5, x0_um=0.25, y0_um=-0.25), surface)


def test_points_keep_grey_confidence_and_what_was_filled(tmp_path):
    surface = make_surface()
    export(surface, tmp_path / "a.ply")
    back = read_surface(tmp_path / "a.ply")
    valid = np.isfinite(surface.z_um)
    np.testing.assert_array_equal(back.origin[valid], surface.origin[valid])
    assert (back.origin[~valid] == Origin.NO_REASON).all()
    np.testing.assert_array_equal(back.all_in_focus[valid], surface.all_in_focus[valid])
    np.testing.assert_array_equal(back.confidence[valid], surface.confidence[valid])
    assert np.isnan(back.z_raw_um[surface.origin == Origin.FILLED]).all()


@pytest.mark.parametrize("ending", [e for e in BOTH if e not in (".npz", ".gwy", ".ply")])
def test_formats_with_heights_only_report_it_on_export_and_import(tmp_path, ending):
    surface = make_surface()
    export(surface, tmp_path / f"a{ending}")
    back = read_surface(tmp_path / f"a{ending}")
    assert back.provenance.notes == (f"Read from a{ending}: heights only.",)
    assert not back.all_in_focus.any()
    assert set(np.unique(back.origin)) <= {Origin.MEASURED, Origin.FILLED, Origin.NO_REASON}
    message = losses(surface, tmp_path / f"a{ending}")
    assert "confidence" in message[0].lower()
    assert "why pixels are unmeasured" in message[0]


def test_a_lossless_format_reports_no_losses(tmp_path):
    assert losses(make_surface(), tmp_path / "a.npz") == ()


@pytest.mark.slow
@pytest.mark.parametrize("ending", WRITTEN)
def test_a_mosaic_is_written_strip_by_strip_as_a_map_is(tmp_path, ending):
    surface = make_surface(rows=300, cols=100, x0_um=0.0, y0_um=0.0)
    reported: list[float] = []
    export(surface, tmp_path / f"a{ending}", every=3)
    export(write_mosaic(tmp_path / "m.zarr", surface), tmp_path / f"b{ending}", every=3, progress=reported.append)
    assert reported == sorted(reported)
    assert reported[-1] == pytest.approx(1.0)
    if ending not in BOTH:
        assert (tmp_path / f"a{ending}").read_bytes() == (tmp_path / f"b{ending}").read_bytes()
        return
    one, other = (read_surface(tmp_path / f"{name}{ending}") for name in "ab")
    np.testing.assert_array_equal(one.z_um, other.z_um)
    np.testing.assert_allclose(one.z_um, surface.z_um[::3, ::3], atol=NEARLY.get(ending, 0) * 10, rtol=0)
    assert one.pixel_um == other.pixel_um == pytest.approx(1.5)


@pytest.mark.parametrize("ending", [".npz", ".x3p", ".csv"])
def test_a_mosaic_is_written_without_its_empty_margin(tmp_path, ending):
    surface = make_surface(rows=300, cols=700, x0_um=1000.0, y0_um=2000.0)
    for layer in (surface.z_um, surface.z_raw_um):
        layer[:32], layer[-32:], layer[:, :270], layer[:, -5:] = np.nan, np.nan, np.nan, np.nan
    surface.origin[np.isnan(surface.z_um)] = Origin.NOT_COVERED
    surface.z_um[40:50, 280:290], surface.origin[40:50, 280:290] = np.nan, Origin.NO_TEXTURE
    export(write_mosaic(tmp_path / "m.zarr", surface), tmp_path / f"a{ending}")
    back = read_surface(tmp_path / f"a{ending}")
    np.testing.assert_allclose(back.z_um, surface.z_um[32:-32, 270:-5], atol=1e-5)
    assert (back.x0_um, back.y0_um) == pytest.approx((1000 + 270 * 0.5, 2000 - 32 * 0.5))


def test_no_comment_of_a_text_looks_like_a_point(tmp_path):
    """MeshLab takes every line of three or six words for one."""
    export(make_surface(simulated=True), tmp_path / "a.xyz")
    comments = [line for line in (tmp_path / "a.xyz").read_text().splitlines() if line.startswith("#")]
    assert len(comments) > 5
    assert not [line for line in comments if len(line.split()) in (3, 6)]


@pytest.mark.parametrize("ending", WRITTEN)
def test_a_writing_that_is_stopped_leaves_nothing(tmp_path, ending):
    requested = iter([False, True, True])
    with pytest.raises(DatasetError, match=r"was stopped at 1 of \d\. Nothing was kept"):
        export(make_surface(rows=300), tmp_path / f"a{ending}", every=1, should_stop=lambda: next(requested))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("ending", WRITTEN)
def test_a_full_disk_is_reported_and_leaves_nothing(tmp_path, ending):
    def full(_):
        raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(DatasetError, match=rf"a\{ending} cannot be written: the disk is full"):
        export(make_surface(), tmp_path / f"a{ending}", progress=full)
    assert not list(tmp_path.iterdir())


def test_what_passes_four_gigabytes_is_reported_before_anything_is_written(tmp_path):
    assert len(losses(MadeWafer(8_000), tmp_path / "a.gwy")) == 1
    assert "holds heights only" in losses(MadeWafer(12_850), tmp_path / "a.gwy")[1]
    with pytest.raises(DatasetError, match=r"a\.gwy would pass the 4 GB of a GWY file: take X3P"):
        export(MadeWafer(20_000), tmp_path / "a.gwy")
    assert not list(tmp_path.iterdir())


def test_a_reading_can_be_stopped(tmp_path):
    export(make_surface(rows=600), tmp_path / "a.x3p")
    with pytest.raises(DatasetError, match=r"Reading a\.x3p was stopped at 0 of 3"):
        read_surface(tmp_path / "a.x3p", should_stop=lambda: True)


# ------------------------------------------------------------------- meshes


@pytest.mark.parametrize("ending", MESHES)
def test_a_mesh_has_the_orientation_of_the_surface(tmp_path, ending):
    import trimesh

    surface = letter_f(pixel_um=0.5, x0_um=1000.25, y0_um=2000.75)
    export(surface, tmp_path / f"a{ending}", every=2)
    mesh = trimesh.load(tmp_path / f"a{ending}", force="mesh", process=False)
    corners = mesh.vertices
    if ending == ".glb":  # glTF has m, and y up
        corners = np.stack([corners[:, 0], -corners[:, 2], corners[:, 1]], axis=1) * 1e6
    if ending == ".stl":
        corners = np.add(corners, [1000.25, 2000.75, 0])
    tall = corners[corners[:, 2] > 30]
    np.testing.assert_allclose(tall[:, 0].min(), 1000.25 + 70 * 0.5, atol=1e-3)
    np.testing.assert_allclose(tall[:, 1].max(), 2000.75 - 50 * 0.5, atol=1e-3)
    np.testing.assert_allclose(np.ptp(corners, axis=0), [78 * 0.5, 58 * 0.5, 40.125 + 0.78], atol=1e-3)
    up = mesh.face_normals[:, 1 if ending == ".glb" else 2]
    assert (up > 0).all()


@pytest.mark.parametrize("ending", MESHES)
def test_a_mesh_has_no_seam_where_its_pieces_meet(tmp_path, ending):
    """Two triangles between every four neighbours, each vertex with its own grey, over several strips."""
    import trimesh

    rng = np.random.default_rng(3)
    z = rng.uniform(1, 2, (300, 9)).astype(np.float32)
    z[rng.random(z.shape) < 0.1] = np.nan
    z[64] = np.nan
    surface = plain(z, pixel_um=1.0, x0_um=0.0, y0_um=0.0)
    export(surface, tmp_path / f"a{ending}")
    mesh = trimesh.load(tmp_path / f"a{ending}", force="mesh", process=False)
    valid = np.isfinite(z)
    squares = valid[:-1, :-1] & valid[:-1, 1:] & valid[1:, :-1] & valid[1:, 1:]
    assert len(mesh.faces) == 2 * squares.sum()
    flat = trimesh.Trimesh(mesh.vertices * (1, 1, 0) if ending != ".glb" else mesh.vertices * (1, 0, 1), mesh.faces)
    assert flat.area == pytest.approx(squares.sum() * (1e-12 if ending == ".glb" else 1.0))
    assert flat.euler_number == trimesh.Trimesh(*by_hand(z)).euler_number
    if ending == ".glb":
        np.testing.assert_array_equal(mesh.visual.vertex_colors[:, 0], surface.all_in_focus[valid])


def by_hand(z):
    """Vertices and triangles of a surface, one square after the other."""
    number = np.arange(z.size).reshape(z.shape)
    rows, cols = np.mgrid[: z.shape[0], : z.shape[1]]
    squares = [number[r : r + 2, c : c + 2] for r, c in np.ndindex(z.shape[0] - 1, z.shape[1] - 1)]
    whole = [n.ravel() for n in squares if np.isfinite(z.ravel()[n]).all()]
    points = np.stack([cols.ravel(), -rows.ravel(), np.zeros(z.size)], axis=1)
    return points, [t for a, b, c, d in whole for t in ((a, c, b), (b, c, d))]


@pytest.mark.slow
@pytest.mark.parametrize("ending", MESHES)
def test_a_mesh_is_written_without_holding_all_of_it(tmp_path, ending):
    def peak_bytes(rows):
        surface = plain(np.ones((rows, 40), np.float32), pixel_um=1.0, x0_um=0.0, y0_um=0.0)
        tracemalloc.start()
        try:
            export(surface, tmp_path / f"a{ending}")
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    peak_bytes(64)
    assert peak_bytes(512) < 1.3 * peak_bytes(128)


def test_a_mesh_of_over_four_gigabytes_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("wafer_viewer.store.formats.mesh._LARGEST_BYTES", 10_000)
    with pytest.raises(DatasetError, match=r"^a\.glb would pass the 4 GB of a GLB file: take fewer points"):
        export(letter_f(), tmp_path / "a.glb")
    assert not list(tmp_path.iterdir())


def test_the_density_of_a_mesh_is_chosen(tmp_path):
    assert every_for((6633, 6633), 1_000_000) == 7
    assert every_for((3, 3), 1_000_000) == 1
    assert density(letter_f(), tmp_path / "a.stl", 300) == 4
    assert density(letter_f(), tmp_path / "a.csv") == 1
    assert "4" in losses(letter_f(), tmp_path / "a.stl", 4)[1]
    with pytest.raises(DatasetError, match="at least 4"):
        density(letter_f(), tmp_path / "a.stl", 2)


# ------------------------------------------------- files of other programs


def test_scales_and_units_of_others(tmp_path):
    """x in mm and z in nm, both message: no contradiction."""
    z = np.arange(12, dtype="<f4").reshape(3, 4)
    head = "Gwyddion Simple Field 1.0\nXRes = 4\nYRes = 3\nXReal = 0.004\nYReal = 0.003\nXYUnits = mm\nZUnits = nm\n"
    (tmp_path / "a.gsf").write_bytes(head.encode() + b"\0" * (4 - len(head) % 4) + z.tobytes())
    back = read_surface(tmp_path / "a.gsf")
    assert back.pixel_um == pytest.approx(1.0)
    np.testing.assert_allclose(back.z_um, z / 1000)
    (tmp_path / "a.csv").write_text(
        "X [mm];Y [mm];Z [um]\n" + "\n".join(f"{c};{-r};{z[r, c]}" for r, c in np.ndindex(3, 4))
    )
    back = read_surface(tmp_path / "a.csv")
    assert (back.pixel_um, back.x0_um, back.y0_um) == pytest.approx((1000, 0, 0))
    np.testing.assert_allclose(back.z_um, z)


@pytest.mark.parametrize("ending", [".csv", ".xyz", ".ply", ".pcd"])
def test_a_regular_lattice_is_recognised_again(tmp_path, ending):
    """Without a word on the lattice, in another order, with a column and a row that have no points."""
    surface = letter_f(pixel_um=0.1, x0_um=250_000.3, y0_um=-7.7)
    surface.z_um[:, 33], surface.z_um[44] = np.nan, np.nan
    rows, cols = np.nonzero(np.isfinite(surface.z_um))
    order = np.random.default_rng(1).permutation(len(rows))
    points = np.stack([surface.x_um[cols], surface.y_um[rows], surface.z_um[rows, cols]], axis=1)[order]
    write_points(tmp_path / f"a{ending}", points)
    back = read_surface(tmp_path / f"a{ending}", z_unit="um")
    assert back.shape == surface.shape
    assert back.pixel_um == pytest.approx(0.1, rel=1e-4)
    assert (back.x0_um, back.y0_um) == pytest.approx((250_000.3, -7.7), abs=0.02 if ending == ".pcd" else 1e-3)
    np.testing.assert_allclose(back.z_um, surface.z_um, atol=1e-5)


def write_points(path, points):
    """As other programs write them: no comments, no units."""
    n = len(points)
    if path.suffix == ".csv":
        lines = ["x,y,z", *(f"{x:.4f},{y:.4f},{z:.6f}" for x, y, z in points)]
        path.write_text("\n".join(lines))
    elif path.suffix == ".xyz":
        np.savetxt(path, points, "%.4f")
        np.savetxt(path, points, ("%.4f", "%.4f", "%.6f"))
    elif path.suffix == ".ply":
        head = f"ply\nformat binary_big_endian 1.0\nelement vertex {n}\n"
        head += "property double x\nproperty double y\nproperty double z\nend_header\n"
        path.write_bytes(head.encode() + points.astype(">f8").tobytes())
    else:
        head = "VERSION 0.7\nFIELDS x y z\nSIZE 8 8 8\nTYPE F F F\nCOUNT 1 1 1\n"
        head += f"WIDTH {n}\nHEIGHT 1\nPOINTS {n}\nDATA binary\n"
        path.write_bytes(head.encode() + points.astype("<f8").tobytes())


def test_scattered_points_are_refused_or_gridded_with_a_word(tmp_path):
    rng = np.random.default_rng(2)
    points = np.column_stack([rng.uniform(0, 20, (4000, 2)), np.full(4000, 3.0)])
    write_points(tmp_path / "a.ply", points)
    with pytest.raises(DatasetError, match=r"a\.ply has scattered points, .* --pixel-um"):
        read_surface(tmp_path / "a.ply", z_unit="um")
    back = read_surface(tmp_path / "a.ply", z_unit="um", pixel_um=1.0)
    assert back.shape == (21, 21)
    np.testing.assert_allclose(back.z_um[1:-1, 1:-1], 3.0)
    assert "gridded on 1 um" in back.provenance.notes[1]


def test_text_of_ply_and_pcd_is_read(tmp_path):
    points = "\n".join(f"{c} {-r} {10 * r + c}" for r, c in np.ndindex(3, 4))
    head = "ply\nformat ascii 1.0\nelement vertex 12\nproperty float x\nproperty float y\nproperty float z\n"
    (tmp_path / "a.ply").write_text(
        f"{head}element face 0\nproperty list uchar int vertex_indices\nend_header\n{points}\n"
    )
    head = "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 12\nHEIGHT 1\nPOINTS 12\nDATA ascii\n"
    (tmp_path / "a.pcd").write_text(f"{head}{points}\n")
    for name in ("a.ply", "a.pcd"):
        back = read_surface(tmp_path / name, z_unit="mm")
        np.testing.assert_allclose(back.z_um, 1000 * (10.0 * np.arange(3)[:, None] + np.arange(4)))


def test_a_tiff_of_imagej_has_its_unit(tmp_path):
    z = np.ones((4, 5), np.float32)
    tifffile.imwrite(tmp_path / "a.tif", z, imagej=True, resolution=(4, 4), metadata={"unit": "um"})
    back = read_surface(tmp_path / "a.tif", z_unit="nm")
    assert back.pixel_um == 0.25
    np.testing.assert_allclose(back.z_um, 0.001)


def test_depths_are_turned_over_when_a_person_says_so(tmp_path):
    (tmp_path / "a.csv").write_text("x_um,y_um,depth_um\n" + "\n".join(f"{c},{r},{r + c}" for r, c in np.ndindex(3, 3)))
    assert read_surface(tmp_path / "a.csv", invert_z=True).z_um.min() == -4


def test_only_a_tiff_of_floats_is_a_surface(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", np.zeros((4, 4), np.uint8))
    tifffile.imwrite(tmp_path / "b.tif", np.zeros((4, 4), np.float32))
    assert [is_surface_file(tmp_path / name) for name in ("a.tif", "b.tif", "c.x3p", "d.png")] == [
        False,
        True,
        True,
        False,
    ]


def test_a_lattice_of_a_whole_wafer_fits_the_floats_of_pcd(tmp_path):
    """A float of 300 mm has steps of a thirtieth of a pixel: the lattice is found again all the same."""
    z = np.ones((2, 640_000), np.float32)
    surface = plain(z, pixel_um=0.46729, x0_um=-150_000.0, y0_um=3.0)
    export(surface, tmp_path / "a.pcd")
    back = read_surface(tmp_path / "a.pcd")
    assert back.shape == surface.shape
    assert math.isclose(back.x0_um, surface.x0_um)
