"""Our files as other programs see them: heights, extents, gaps and orientation of a surface with nothing alike in it.

Each runs where its program is installed: Gwyddion and CloudCompare by the system's packages, the others by pip.
"""

from __future__ import annotations

import os
import shutil
import subprocess

import numpy as np
import pytest

from tests.store.formats.test_formats import letter_f
from wafer_viewer.model.file_formats import WRITTEN
from wafer_viewer.numerics.open3d_library import load_open3d
from wafer_viewer.store.formats.conversion import export, read_surface

PLACE = {"pixel_um": 0.5, "x0_um": 1000.25, "y0_um": 2000.75}
LOW, HIGH = (1000.25, 1971.25, 0.0), (1039.75, 2000.75, 40.915)
"""The corners of the points, in um."""
EXTENTS = (*LOW, *HIGH, 1035.25, 1971.25, 1039.75, 1975.75)
"""The corners, and those of the tall part, where x is large and y small, in um."""
WIDTH_M, HEIGHT_M = 40e-6, 30e-6
POINTS = 60 * 80 - 60


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """The surface in every format, its meshes at full density."""
    folder = tmp_path_factory.mktemp("oracles")
    for ending in WRITTEN:
        export(letter_f(**PLACE), folder / f"a{ending}", every=1)
    return folder


@pytest.fixture(scope="module")
def z_um():
    return letter_f(**PLACE).z_um.astype(float)


def program(name):
    if (found := shutil.which(name)) is None:
        pytest.skip(f"no {name} on this machine: apt-get install {name.lower()}")
    return found


@pytest.mark.slow
@pytest.mark.parametrize(("ending", "unit"), [(".gsf", 1e6), (".gwy", 1e6), (".x3p", 1e6), (".tif", 1.0)])
def test_gwyddion(written, z_um, tmp_path, ending, unit):
    """It has no units of TIFF (2.62)."""
    gwyfile = pytest.importorskip("gwyfile")
    out = tmp_path / "out.gwy"
    environment = os.environ | {"HOME": str(tmp_path)}
    done = [program("gwyddion"), f"--convert-to-gwy={out}", str(written / f"a{ending}")]
    subprocess.run(done, env=environment, check=True, capture_output=True, timeout=120)
    tree = gwyfile.load(str(out))
    field = tree["/0/data"]
    found = np.where(tree["/0/mask"].data > 0, np.nan, field.data * unit)
    np.testing.assert_allclose(found, z_um, atol=2e-5)
    if ending != ".tif":
        assert (field.xreal, field.yreal) == pytest.approx((WIDTH_M, HEIGHT_M))
    if ending in (".gsf", ".gwy"):
        assert (field.xoff, field.yoff) == pytest.approx((1000e-6, -2001e-6))


def test_gwyfile(written, z_um):
    gwyfile = pytest.importorskip("gwyfile")
    tree = gwyfile.load(str(written / "a.gwy"))
    channels = gwyfile.util.get_datafields(tree)
    assert list(channels) == ["Heights", "Measured heights", "Confidence", "All in focus", "Origin"]
    heights = np.where(tree["/0/mask"].data > 0, np.nan, channels["Heights"].data * 1e6)
    np.testing.assert_allclose(heights, z_um, atol=1e-9)
    assert channels["Heights"].si_unit_z.unitstr == "m"


def test_x3pio(written, z_um, tmp_path):
    """Both ways; the first row is the top edge."""
    x3pio = pytest.importorskip("x3pio")
    found = x3pio.read(written / "a.x3p")
    np.testing.assert_allclose(found.layers[0].z * 1e6, z_um, atol=1e-9)
    assert (found.header.x.increment, found.header.y.increment) == pytest.approx((5e-7, 5e-7))
    np.testing.assert_allclose(np.asarray(found.placement.offset) * 1e6, (LOW[0], -HIGH[1], 0), atol=1e-9)
    for kind, scale in ((x3pio.DataType.FLOAT64, 1.0), (x3pio.DataType.INT32, "auto")):
        x3pio.write(tmp_path / "b.x3p", z_um * 1e-6, x_scale=5e-7, y_scale=5e-7, z_type=kind, z_scale=scale)
        back = read_surface(tmp_path / "b.x3p")
        np.testing.assert_allclose(back.z_um, z_um, atol=1e-5)
        assert back.pixel_um == pytest.approx(0.5)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("ending", [".gwy", ".x3p"])
def test_surface_topography(written, z_um, ending):
    """It counts rows along x, from the top."""
    topography = pytest.importorskip("SurfaceTopography").open_topography(str(written / f"a{ending}")).topography()
    np.testing.assert_allclose(np.ma.filled(topography.heights().T, np.nan) * 1e6, z_um, atol=1e-6)
    assert topography.unit == "m"
    assert topography.physical_sizes == pytest.approx((WIDTH_M, HEIGHT_M))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("ending", [".gwy", ".x3p"])
def test_surfalize(written, z_um, ending):
    found = pytest.importorskip("surfalize").Surface.load(str(written / f"a{ending}"))
    np.testing.assert_allclose(found.data, z_um, atol=1e-6)
    assert (found.step_x, found.step_y) == pytest.approx((0.5, 0.5))


@pytest.mark.slow
@pytest.mark.parametrize("ending", [".ply", ".pcd", ".xyz", ".obj", ".stl", ".glb"])
def test_open3d(written, ending):
    open3d = load_open3d()
    if ending in (".ply", ".pcd", ".xyz"):
        points = np.asarray(open3d.io.read_point_cloud(str(written / f"a{ending}")).points)
        assert len(points) == POINTS
    else:
        points = np.asarray(open3d.io.read_triangle_mesh(str(written / f"a{ending}")).vertices)
    np.testing.assert_allclose(extents(points, ending), EXTENTS, atol=1e-3)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("ending", [".ply", ".obj", ".stl"])
def test_meshio(written, ending):
    points = pytest.importorskip("meshio").read(written / f"a{ending}").points
    np.testing.assert_allclose(extents(points, ending), EXTENTS, atol=1e-3)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("ending", [".ply", ".obj", ".stl"])
def test_pyvista(written, ending):
    points = np.asarray(pytest.importorskip("pyvista").read(written / f"a{ending}").points)
    np.testing.assert_allclose(extents(points, ending), EXTENTS, atol=1e-3)


def test_meshlab(written):
    """It takes comments of three or six words for points."""
    mesh = pytest.importorskip("pymeshlab", reason="pip install pymeshlab").MeshSet()
    mesh.load_new_mesh(str(written / "a.xyz"))
    points = mesh.current_mesh().vertex_matrix()
    assert len(points) == POINTS
    np.testing.assert_allclose(extents(points, ".xyz"), EXTENTS, atol=1e-3)


def test_gdal(written, z_um):
    with pytest.importorskip("rasterio", reason="pip install rasterio").open(written / "a.tif") as raster:
        np.testing.assert_array_equal(raster.read(1), z_um.astype(np.float32))
        assert raster.transform.to_gdal() == pytest.approx((1000, 0.5, 0, 2001, 0, -0.5))
        assert np.isnan(raster.nodata)


def test_cloud_compare(written, tmp_path):
    out = tmp_path / "out.asc"
    words = ["-SILENT", "-AUTO_SAVE", "OFF", "-C_EXPORT_FMT", "ASC", "-PREC", "6", "-O", str(written / "a.ply")]
    subprocess.run(
        [program("CloudCompare"), *words, "-SAVE_CLOUDS", "FILE", str(out)],
        env=os.environ | {"QT_QPA_PLATFORM": "offscreen", "HOME": str(tmp_path)},
        stdin=subprocess.DEVNULL,
        check=True,
        capture_output=True,
        timeout=120,
    )
    points = np.loadtxt(out)[:, :3]
    assert len(points) == POINTS
    np.testing.assert_allclose(extents(points, ".ply"), EXTENTS, atol=1e-3)


def extents(points, ending):
    """Lowest and highest corner of the points, then the same of those over 30 um in x and y, in stage um."""
    if ending == ".glb":  # m, and y up
        points = np.stack([points[:, 0], -points[:, 2], points[:, 1]], axis=1) * 1e6
    if ending in (".stl", ".pcd"):  # from the corner of the surface
        points = points + np.array([PLACE["x0_um"], PLACE["y0_um"], 0])
    tall = points[points[:, 2] > 30]
    return (*points.min(axis=0), *points.max(axis=0), *tall.min(axis=0)[:2], *tall.max(axis=0)[:2])
