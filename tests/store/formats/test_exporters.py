from __future__ import annotations

import base64
import dataclasses
import json
import re
import zlib

import numpy as np
import pytest
import tifffile

from tests.support.datasets.samples import CALIBRATION, assert_same_surface, make_surface
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.file_formats import WRITTEN
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.store.formats.conversion import caveats, export, read_surface
from wafer_viewer.store.formats.npz_file import read_npz
from wafer_viewer.store.mosaic.zarr_mosaic import write_mosaic

TEXTS = [ending for ending in WRITTEN if ending not in (".npz", ".glb")]


@pytest.mark.parametrize("grey", [np.uint8, np.uint16])
def test_npz_round_trips(tmp_path, grey):
    surface = make_surface(grey=grey, recipe=Recipe(window=9), calibration=CALIBRATION, simulated=True, notes=("a",))
    export(surface, tmp_path / "a.npz")
    back = read_npz(tmp_path / "a.npz")
    assert_same_surface(back, surface)
    assert back.overlap_um is None


def test_differences_of_overlaps_are_written_too(tmp_path):
    surface = make_surface()
    overlap = np.where(surface.origin == 0, np.float32(0.25), np.float32(np.nan))
    export(dataclasses.replace(surface, overlap_um=overlap), tmp_path / "a.npz")
    np.testing.assert_array_equal(read_npz(tmp_path / "a.npz").overlap_um, overlap)


@pytest.mark.parametrize("ending", [".npz", ".gwy", ".ply"])
def test_uncertainties_come_back_from_formats_with_layers(tmp_path, ending):
    surface = uncertain()
    export(surface, tmp_path / f"a{ending}")
    back = read_surface(tmp_path / f"a{ending}")
    expected = surface.u_um if ending != ".ply" else np.where(np.isfinite(surface.z_um), surface.u_um, np.nan)
    np.testing.assert_allclose(back.u_um, expected, rtol=1e-6)
    export(make_surface(), tmp_path / f"b{ending}")
    assert read_surface(tmp_path / f"b{ending}").u_um is None


def test_every_other_pixel_has_its_own_uncertainty(tmp_path):
    surface = uncertain()
    export(surface, tmp_path / "a.npz", every=2)
    np.testing.assert_array_equal(read_npz(tmp_path / "a.npz").u_um, surface.u_um[::2, ::2])


def test_an_npz_of_an_earlier_version_opens_without_uncertainties(tmp_path):
    export(uncertain(), tmp_path / "new.npz")
    with np.load(tmp_path / "new.npz") as file:
        np.savez(tmp_path / "old.npz", **{name: file[name] for name in file if name != "u_um"})
    back = read_npz(tmp_path / "old.npz")
    assert back.u_um is None
    assert_same_surface(back, make_surface())


def uncertain() -> HeightMap:
    surface = make_surface()
    u_um = np.linspace(0.1, 0.4, surface.z_um.size, dtype=np.float32).reshape(surface.shape)
    return dataclasses.replace(surface, u_um=np.where(surface.measured, u_um, np.float32(np.nan)))


def test_npz_has_the_keys_that_others_read(tmp_path):
    surface = make_surface()
    export(surface, tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz") as file:
        assert {"z_um", "confidence", "origin", "all_in_focus", "pixel_um", "x0_um", "y0_um"} <= set(file)
        np.testing.assert_array_equal(file["z_um"], surface.z_um)
        assert float(file["pixel_um"]) == surface.pixel_um


def test_a_surface_read_from_npz_can_be_changed_without_changing_the_file(tmp_path):
    surface = make_surface()
    export(surface, tmp_path / "a.npz")
    read_npz(tmp_path / "a.npz").z_um[:] = 0
    assert_same_surface(read_npz(tmp_path / "a.npz"), surface)


def test_compressed_npz_is_read_too(tmp_path):
    surface = make_surface()
    export(surface, tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz") as file:
        np.savez_compressed(tmp_path / "b.npz", **file)
    assert_same_surface(read_npz(tmp_path / "b.npz"), surface)


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda p: None, "does not exist"),
        (lambda p: p.write_text("no"), "cannot be read as .npz"),
        (lambda p: np.savez(p, z_um=np.zeros((2, 2))), "is not a height map"),
        (lambda p: (export(make_surface(), p), p.write_bytes(p.read_bytes()[:3000])), "cannot be read as .npz"),
    ],
)
def test_a_file_that_is_no_height_map(tmp_path, make, sentence):
    make(tmp_path / "a.npz")
    with pytest.raises(DatasetError, match=sentence):
        read_npz(tmp_path / "a.npz")


def test_tiff_holds_heights_and_the_pixel_size(tmp_path):
    surface = make_surface(pixel_um=0.46729)
    export(surface, tmp_path / "a.tif")
    with tifffile.TiffFile(tmp_path / "a.tif") as file:
        np.testing.assert_array_equal(file.asarray(), surface.z_um)
        assert 1 / file.pages.first.get_resolution("MICROMETER")[0] == pytest.approx(0.46729, rel=1e-6)
        about = json.loads(file.pages.first.description)
    assert about["x0_um"] == surface.x0_um
    assert about["unit"] == "um"


def stage_points(surface):
    rows, cols = np.nonzero(np.isfinite(surface.z_um))
    return np.stack([surface.x_um[cols], surface.y_um[rows], surface.z_um[rows, cols]], axis=1)


def test_ply_opens_elsewhere_with_its_colours(tmp_path):
    import trimesh

    surface = make_surface()
    export(surface, tmp_path / "a.ply")
    cloud = trimesh.load(tmp_path / "a.ply")
    np.testing.assert_allclose(cloud.vertices, stage_points(surface))
    np.testing.assert_array_equal(cloud.colors[:, 0], surface.all_in_focus[np.isfinite(surface.z_um)])


def test_csv_is_a_table_of_stage_points(tmp_path):
    surface = make_surface()
    export(surface, tmp_path / "a.csv")
    lines = (tmp_path / "a.csv").read_text().splitlines()
    table = [line for line in lines if not line.startswith("#")]
    assert table[0] == "x_um,y_um,z_um,origin"
    values = np.loadtxt(table[1:], delimiter=",")
    np.testing.assert_allclose(values[:, :3], stage_points(surface), atol=6e-5)
    np.testing.assert_array_equal(values[:, 3], surface.origin[np.isfinite(surface.z_um)])


def test_stl_is_a_mesh_that_faces_up_and_leaves_holes(tmp_path):
    import trimesh

    surface = make_surface(rows=20, cols=40, x0_um=0.0, y0_um=0.0)
    flat = dataclasses.replace(surface, z_um=np.where(np.isfinite(surface.z_um), np.float32(7), surface.z_um))
    export(flat, tmp_path / "a.stl")
    mesh = trimesh.load(tmp_path / "a.stl")
    valid = np.isfinite(flat.z_um)
    squares = valid[:-1, :-1] & valid[1:, :-1] & valid[:-1, 1:] & valid[1:, 1:]
    assert mesh.area == pytest.approx(squares.sum() * 0.25)
    assert (mesh.face_normals[:, 2] > 0.99).all()
    np.testing.assert_allclose(mesh.bounds, [[0, -9.5, 7], [19.5, 0, 7]])


@pytest.mark.parametrize("ending", TEXTS)
def test_simulated_and_uncalibrated_data_are_marked(tmp_path, ending):
    export(make_surface(simulated=True), tmp_path / f"a{ending}")
    message = (tmp_path / f"a{ending}").read_bytes()
    assert b"SIMULATED" in message
    assert b"uncalibrated: no calibration" in message
    export(make_surface(calibration=CALIBRATION), tmp_path / f"b{ending}")
    assert b"SIMULATED" not in (tmp_path / f"b{ending}").read_bytes()


def test_a_calibration_holds_until_it_is_due():
    surface = make_surface(calibration=CALIBRATION)
    assert caveats(surface.provenance, "2026-12-31") == ()
    assert caveats(surface.provenance, "2027-06-01") == ("uncalibrated: the calibration was due on 2027-01-01",)


def test_an_unknown_ending_names_the_choices(tmp_path):
    with pytest.raises(DatasetError, match=r"a.abc has no ending that is known: take one of .npz, .gwy, .x3p, .gsf"):
        export(make_surface(), tmp_path / "a.abc")


def test_a_failed_export_leaves_the_old_file(tmp_path):
    blind = make_surface(rows=2, cols=2)
    blind.z_um[:] = np.nan
    (tmp_path / "a.stl").write_text("old")
    with pytest.raises(DatasetError, match=r"a\.stl would hold no triangle"):
        export(blind, tmp_path / "a.stl")
    assert [p.name for p in tmp_path.iterdir()] == ["a.stl"]
    assert (tmp_path / "a.stl").read_text() == "old"
    with pytest.raises(DatasetError, match="its folder does not exist"):
        export(blind, tmp_path / "nowhere/a.csv")


def test_a_mosaic_is_written_like_a_map(tmp_path):
    surface = make_surface()
    export(write_mosaic(tmp_path / "m.zarr", surface), tmp_path / "a.npz")
    assert_same_surface(read_npz(tmp_path / "a.npz"), surface)


def test_a_web_page_holds_heights_to_half_a_code_and_its_gaps(tmp_path):
    surface = make_surface(simulated=True)
    page = export(surface, tmp_path / "a.html").read_text()
    facts = json.loads(re.search(r'id="facts">(.*?)</script>', page)[1])
    packed = zlib.decompress(base64.b64decode(re.search(r'id="heights">(.*?)</script>', page)[1]))
    low, high = np.frombuffer(packed, np.uint8).reshape(2, *surface.shape).astype(np.uint16)
    codes = np.cumsum(low + (high << 8), axis=1, dtype=np.uint16)
    np.testing.assert_array_equal(codes == 0, np.isnan(surface.z_um))
    heights = facts["low_um"] + (codes - 1.0) * facts["step_um"]
    np.testing.assert_allclose(heights[codes > 0], surface.z_um[codes > 0], atol=0.51 * facts["step_um"])
    assert (facts["rows"], facts["cols"], facts["pixel_um"], facts["every"]) == (30, 40, 0.5, 1)
    assert set(facts["maps"]["Viridis"][:3]) == {68, 1, 84}


def test_a_web_page_of_nothing_or_of_too_much_is_refused(tmp_path, monkeypatch):
    surface = make_surface()
    nothing = dataclasses.replace(surface, z_um=np.full(surface.shape, np.nan, np.float32))
    with pytest.raises(DatasetError, match="would show nothing: no pixel has a height"):
        export(nothing, tmp_path / "a.html")
    monkeypatch.setattr("wafer_viewer.store.formats.web_page.MOST_POINTS", 1000)
    with pytest.raises(DatasetError, match="more than 0 million points: take fewer"):
        export(surface, tmp_path / "a.html", every=1)
    assert not (tmp_path / "a.html").exists()
