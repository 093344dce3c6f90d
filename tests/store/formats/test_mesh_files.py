"""Meshes read as surfaces: ours and those of other programs, seen from above."""

from __future__ import annotations

import contextlib
import sys

import numpy as np
import pytest
from scipy.spatial import Delaunay

from tests.store.formats.test_formats import letter_f
from tests.support.datasets.samples import make_surface
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.formats.conversion import export, read_surface

MM = 1e3
KINDS = {".stl": {"z_unit": "um"}, ".obj": {"z_unit": "um"}, ".ply": {"z_unit": "um"}, ".glb": {}, ".3mf": {}}
"""Endings, and what has to be said of a mesh."""


def write(path, mesh):
    """Write a mesh in um as other programs do: glTF in m with y up, 3MF in mm."""
    mesh = mesh.copy()
    if path.suffix == ".glb":
        mesh.vertices = mesh.vertices[:, [0, 2, 1]] * (1e-6, 1e-6, -1e-6)
    if path.suffix == ".3mf":
        pytest.importorskip("lxml", reason="pip install 'wafer-viewer[surfaces]'")
        mesh.vertices /= MM
        mesh.units = "millimeter"
    path.write_bytes(data if isinstance(data := mesh.export(file_type=path.suffix[1:]), bytes) else data.encode())
    return path


def plane(n=400):
    """Triangulate scattered points of a slope; nothing alike along x and y."""
    import trimesh

    xy = np.vstack([np.random.default_rng(3).uniform(0, (40, 25), (n, 2)), [(0, 0), (40, 0), (0, 25), (40, 25)]])
    return trimesh.Trimesh(np.column_stack([xy, 0.1 * xy[:, 0] + 0.3 * xy[:, 1]]), Delaunay(xy).simplices)


@pytest.mark.parametrize("ending", KINDS)
def test_a_slope_is_the_slope_at_every_pixel(tmp_path, ending):
    back = read_surface(write(tmp_path / f"a{ending}", plane()), pixel_um=0.25, **KINDS[ending])
    assert back.shape == (101, 161)
    assert (back.x0_um, back.y0_um) == pytest.approx((0, 25), abs=1e-5)
    known = np.isfinite(back.z_um)
    assert known.mean() > 0.98  # rounded corners may lie off the border
    np.testing.assert_allclose(
        back.z_um, np.where(known, 0.1 * back.x_um + 0.3 * back.y_um[:, None], np.nan), atol=1e-4
    )
    assert "seen from above at pixels of 0.25 um" in " ".join(back.provenance.notes)


@pytest.mark.parametrize("ending", KINDS)
def test_a_lattice_is_recognised(tmp_path, ending):
    """Vertices on a lattice that their triangles join are the heights themselves, gaps included."""
    import trimesh

    z = np.random.default_rng(1).normal(size=(20, 30)) + 0.1 * np.arange(30)
    y, x = np.mgrid[19.0:-1:-1, :30]
    n = np.arange(600).reshape(20, 30)
    a, b, c, d = n[:-1, :-1].ravel(), n[:-1, 1:].ravel(), n[1:, :-1].ravel(), n[1:, 1:].ravel()
    triangles = np.concatenate([np.column_stack([a, c, b]), np.column_stack([b, c, d])])
    points = np.column_stack([0.5 * x.ravel(), 0.5 * y.ravel(), z.ravel()])
    gone = (triangles == n[7, 9]).any(axis=1)
    mesh = trimesh.Trimesh(points, triangles[~gone], process=False)
    mesh.remove_unreferenced_vertices()
    back = read_surface(write(tmp_path / f"a{ending}", mesh), **KINDS[ending])
    assert back.pixel_um == pytest.approx(0.5, rel=1e-5)
    z[7, 9] = np.nan
    np.testing.assert_allclose(back.z_um, z, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("ending", KINDS)
def test_the_highest_of_several_surfaces_is_seen(tmp_path, ending):
    import trimesh

    plate = trimesh.creation.box((40, 20, 2), trimesh.transformations.translation_matrix((20, 10, 0)))
    ball = trimesh.creation.icosphere(4, 5.0)
    ball.apply_translation((30, 14, 8))
    back = read_surface(write(tmp_path / f"a{ending}", trimesh.util.concatenate([plate, ball])), **KINDS[ending])
    assert 250_000 <= back.z_um.size <= 4_100_000
    assert np.isfinite(back.z_um).mean() > 0.99
    r = np.hypot(back.x_um - 30, back.y_um[:, None] - 14)
    np.testing.assert_allclose(back.z_um[r > 5.1], 1, atol=1e-5)
    expected = 8 + np.sqrt(np.maximum(0, 25 - r**2))
    np.testing.assert_allclose(back.z_um[r < 4], expected[r < 4], atol=0.03)


@pytest.mark.parametrize("ending", [".stl", ".obj", ".glb"])
@pytest.mark.parametrize("simulated", [True, False])
def test_our_meshes_come_back(tmp_path, ending, simulated):
    surface = letter_f(pixel_um=0.5, x0_um=1000.25, y0_um=2000.75)
    export(surface, tmp_path / f"a{ending}", every=1)
    back = read_surface(tmp_path / f"a{ending}")
    np.testing.assert_allclose(back.z_um, surface.z_um, atol=1e-5)
    assert back.pixel_um == pytest.approx(0.5)
    place = (0, 0) if ending == ".stl" else (1000.25, 2000.75)
    assert (back.x0_um, back.y0_um) == pytest.approx(place, abs=1e-3)
    export(make_surface(simulated=simulated), tmp_path / f"b{ending}")
    assert read_surface(tmp_path / f"b{ending}").provenance.simulated == simulated
    assert read_surface(tmp_path / f"b{ending}", pixel_um=0.31).provenance.simulated == simulated


@pytest.mark.parametrize("ending", [".stl", ".obj", ".ply"])
def test_a_mesh_without_a_unit_is_asked_for_it(tmp_path, ending):
    with pytest.raises(DatasetError, match=rf"^a\{ending} states no unit of its heights: give it, as in --z-unit um"):
        read_surface(write(tmp_path / f"a{ending}", plane(20)))
    back = read_surface(tmp_path / f"a{ending}", z_unit="mm", invert_z=True)
    assert np.nanmin(back.z_um) == pytest.approx(-11_500, rel=0.02)


def test_what_a_glb_states_is_not_overruled(tmp_path):
    with pytest.raises(DatasetError, match="states heights in m, but --z-unit is mm"):
        read_surface(write(tmp_path / "a.glb", plane(20)), z_unit="mm")


@pytest.mark.slow
def test_a_million_pixels_under_one_triangle(tmp_path):
    import trimesh

    path = write(tmp_path / "a.stl", trimesh.Trimesh([(0, 0, 0), (1500, 0, 3), (0, 1500, 6)], [(0, 1, 2)]))
    back = read_surface(path, z_unit="um", pixel_um=1)
    assert back.shape == (1501, 1501)
    assert np.isfinite(back.z_um).sum() == 1501 * 1502 / 2
    assert back.z_um[-1, 500] == pytest.approx(1)
    with pytest.raises(DatasetError, match=r"would have 150001 x 150001 pixels of 0\.01 um: give a larger --pixel-um"):
        read_surface(path, z_unit="um", pixel_um=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("ending", KINDS)
def test_a_damaged_mesh_ends_in_one_sentence(tmp_path, ending):
    path, rng = write(tmp_path / f"a{ending}", plane(40)), np.random.default_rng(7)
    good = path.read_bytes()
    for _ in range(25):
        content = bytearray(good[: rng.integers(len(good))] if rng.random() < 0.5 else good)
        for at in rng.integers(0, max(1, len(content)), 4):
            content[at : at + 1] = bytes([rng.integers(256)])
        path.write_bytes(content)
        with contextlib.suppress(DatasetError):
            assert read_surface(path, **KINDS[ending]).z_um.ndim == 2


def test_an_entity_of_a_3mf_is_refused(tmp_path):
    import zipfile

    path = write(tmp_path / "a.3mf", plane(20))
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in members.items():
            archive.writestr(
                name, content.replace(b"?>", b"?><!DOCTYPE x [<!ENTITY a SYSTEM 'file:///etc/passwd'>]>", 1)
            )
    with pytest.raises(DatasetError, match="has a document type in its XML"):
        read_surface(path)


def test_without_the_extra_the_remedy_is_named(tmp_path, monkeypatch):
    path = write(tmp_path / "a.stl", plane(20))
    monkeypatch.setitem(sys.modules, "trimesh", None)
    with pytest.raises(
        DatasetError, match=r"^a\.stl is a mesh, read by an extra: pip install 'wafer-viewer\[surfaces\]'\.$"
    ):
        read_surface(path)
