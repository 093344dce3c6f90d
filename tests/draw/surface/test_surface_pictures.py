"""From heights to what the browser draws: colours, light, meshes, files."""

from __future__ import annotations

import dataclasses
import io
import json
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from tests.support.page_stand_in import height_map
from wafer_viewer.draw.colormaps import COLOUR_MAPS, ELSEWHERE, table
from wafer_viewer.draw.raster_text import tag, text_atlas
from wafer_viewer.draw.surface import mesh
from wafer_viewer.draw.surface.display_style import DisplayStyle, Light
from wafer_viewer.draw.surface.mesh import as_shown, painted, plates, to_texture
from wafer_viewer.draw.surface.texture_baking import bake, light_gain, reduced, shade, without_gaps
from wafer_viewer.model.surface.height_map import HeightMap

FLAT = DisplayStyle(hillshade=0.0, low=0.0, high=10.0)


def cone(n: int = 80, hole: bool = False) -> np.ndarray:
    y, x = np.mgrid[:n, :n] - n / 2
    z = np.maximum(0, 10 - np.hypot(x, y) / 3).astype(np.float32)
    if hole:
        z[10:20, 10:30] = np.nan
    return z


def parts(data: bytes) -> tuple[dict, bytes]:
    magic, version, length, n, kind = struct.unpack_from("<4sIII4s", data)
    assert (magic, version, length, kind) == (b"glTF", 2, len(data), b"JSON")
    return json.loads(data[20 : 20 + n]), data[28 + n :]


@pytest.mark.parametrize(("name", "worst"), [("mako", 3), ("batlow", 8), ("grey", 1)])
def test_the_screen_shows_the_colours_of_the_bar(name: str, worst: int) -> None:
    difference = as_shown(to_texture(table(name))).astype(int) - table(name)
    assert np.abs(difference).max() <= worst


@pytest.mark.parametrize("name", COLOUR_MAPS)
def test_maps_grow_lighter_from_end_to_end(name: str) -> None:
    lightness = table(name).astype(float) @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(lightness) > -0.6).all()
    assert lightness[-1] > lightness[0] + 100


def test_height_is_coloured_by_its_place_in_the_range() -> None:
    ramp = np.tile(np.linspace(-5, 15, 256, dtype=np.float32), (8, 1))
    picture = bake(height_map(ramp), FLAT, Light())
    assert tuple(picture[4, 0, :3]) == tuple(table("mako")[0])
    assert tuple(picture[4, -1, :3]) == tuple(table("mako")[-1])
    middle = np.abs(ramp[4] - 5).argmin()
    assert np.abs(picture[4, middle, :3].astype(int) - table("mako")[127]).max() <= 2


def test_what_is_not_measured_is_not_drawn_and_lends_no_colour() -> None:
    picture = bake(height_map(cone(hole=True)), FLAT, Light())
    assert (picture[10:20, 10:30, 3] == 0).all()
    assert (picture[..., 3] == 255).sum() == 80 * 80 - 200
    whole = bake(height_map(cone()), FLAT, Light())
    assert np.array_equal(picture[picture[..., 3] == 255], whole[picture[..., 3] == 255])


def test_light_comes_from_the_north_west() -> None:
    z = cone(81)
    shading = shade(z, 1.0, 1.0, 10.0)
    assert shading.lambert[25, 25] > 1.1
    assert shading.lambert[55, 55] < 0.9
    assert shading.lambert[2, 2] == pytest.approx(1.0, abs=0.01)


@given(st.floats(0.05, 50), st.floats(0.01, 400))
def test_light_does_not_depend_on_the_unit_of_the_relief(pixel_um: float, stretch: float) -> None:
    z = cone(40)
    plain = shade(z, 1.0, light_gain(z, 1.0), 10.0)
    scaled_z = z * np.float32(stretch * pixel_um)
    gain = light_gain(z * np.float32(pixel_um), pixel_um) / np.float32(stretch)
    other = shade(scaled_z, pixel_um, gain, 10.0 * stretch * pixel_um)
    assert np.allclose(plain.lambert, other.lambert, atol=0.02)
    assert np.allclose(plain.occlusion, other.occlusion, atol=0.02)


def test_gaps_take_the_nearest_height_and_an_empty_map_is_level() -> None:
    z = cone(hole=True)
    filled = without_gaps(z)
    assert np.isfinite(filled).all()
    assert np.array_equal(filled[np.isfinite(z)], z[np.isfinite(z)])
    assert (without_gaps(np.full((4, 5), np.nan, np.float32)) == 0).all()


@pytest.mark.parametrize("quantity", ["height", "confidence", "slope", "deviation", "grey", "origin"])
def test_every_quantity_can_be_painted_over_gaps(quantity: str) -> None:
    look = DisplayStyle(colour_by=quantity, low=0.0, high=1.0, all_in_focus=0.5)  # pyright: ignore[reportArgumentType]
    picture = bake(height_map(cone(hole=True)), look, Light())
    assert picture.shape == (80, 80, 4)
    assert picture.dtype == np.uint8


@given(st.integers(2, 40), st.integers(2, 40), st.integers(1, 7))
def test_a_mesh_reaches_every_edge_of_its_pixels(rows: int, cols: int, step: int) -> None:
    x, y = np.arange(cols, dtype=np.float32), -np.arange(rows, dtype=np.float32)
    made = mesh.surface(np.zeros((rows, cols), np.float32), np.ones((rows, cols), bool), x, y, 0.0, step)
    assert made.vertices[:, 0].max() == cols - 1
    assert made.vertices[:, 1].min() == -(rows - 1)
    assert made.uv.min() > 0
    assert made.uv.max() < 1
    assert made.triangles.max() == len(made.vertices) - 1
    a, b, c = (made.vertices[made.triangles[:, k]] for k in range(3))
    assert np.cross(b - a, c - a)[:, 2].sum() / 2 == pytest.approx((rows - 1) * (cols - 1))


def test_cells_without_a_measured_pixel_are_left_out() -> None:
    present = np.ones((9, 9), bool)
    present[:, 4:] = False
    axis = np.arange(9, dtype=np.float32)
    made = mesh.surface(np.zeros((9, 9), np.float32), present, axis, -axis, 0.0, 2)
    used = made.vertices[np.unique(made.triangles)]
    assert used[:, 0].max() == 4


def test_no_rags_hang_from_the_edge_of_a_hole_in_a_wall() -> None:
    z = np.zeros((9, 9), np.float32)
    z[:, 5:] = 100.0
    present = np.ones((9, 9), bool)
    present[::2, 4] = False
    axis = np.arange(9, dtype=np.float32) * 1e-3
    made = mesh.surface(z, present, axis, -axis, 0.0, 1)
    rise = np.ptp(made.vertices[made.triangles][..., 2], axis=1)
    assert rise.max() < 0.05


def test_walls_go_down_from_what_is_measured_only() -> None:
    x = np.arange(6, dtype=np.float32)
    z = np.array([1, 1, np.nan, np.nan, 2, 2], np.float32)
    made = mesh.walls({0: (x, np.zeros(6, np.float32), z)}, 0.0)
    used = made.vertices[np.unique(made.triangles)]
    assert set(used[:, 0].tolist()) == {0.0, 1.0, 4.0, 5.0}
    assert made.uv[0, 0] == pytest.approx(0.5 / mesh.WALL_SIDES)


def test_a_glb_can_be_read_back() -> None:
    picture = bake(height_map(cone()), FLAT, Light())
    axis = np.arange(80, dtype=np.float32)
    made = mesh.surface(cone(), picture[..., 3] > 0, axis, -axis, 0.0, 3)
    document, blob = parts(painted(made, picture))
    view = document["bufferViews"]
    places = np.frombuffer(blob, "<f4", len(made.vertices) * 3, view[0]["byteOffset"]).reshape(-1, 3)
    assert np.array_equal(places, made.vertices)
    indices = np.frombuffer(blob, "<u2", made.triangles.size, view[2]["byteOffset"])
    assert np.array_equal(indices, made.triangles.ravel())
    image = Image.open(io.BytesIO(blob[view[3]["byteOffset"] :][: view[3]["byteLength"]]))
    assert (image.format, image.size) == ("JPEG", (80, 80))
    assert document["materials"][0]["alphaMode"] == "OPAQUE"


def test_holes_make_a_mask_and_translucency_a_blend() -> None:
    rectangle = mesh.flat(0, 0, 1, 1)
    picture = np.full((4, 4, 4), 255, np.uint8)
    picture[0, 0, 3] = 0
    assert parts(painted(rectangle, picture))[0]["materials"][0]["alphaMode"] == "MASK"
    assert parts(painted(rectangle, picture, blend=True))[0]["materials"][0]["alphaMode"] == "BLEND"


@given(st.integers(1, 5), st.integers(3, 30), st.integers(3, 30))
def test_a_reduced_map_keeps_its_place_and_its_mean(factor: int, rows: int, cols: int) -> None:
    rng = np.random.default_rng(rows * 31 + cols)
    plain = height_map(rng.normal(size=(rows * factor, cols * factor)), 2.0, 100.0, 50.0)
    small = reduced(plain, factor)
    assert small.shape == (rows, cols)
    assert small.z_um.mean() == pytest.approx(plain.z_um.mean(), abs=1e-4)
    assert small.x_um.mean() == pytest.approx(plain.x_um.mean())
    assert small.y_um.mean() == pytest.approx(plain.y_um.mean())


def test_a_block_is_measured_as_soon_as_a_pixel_of_it_is() -> None:
    z = np.full((4, 5), np.nan)
    z[0, 0] = 3.0
    small = reduced(height_map(z), 2)
    assert small.shape == (2, 3)
    assert small.z_um[0, 0] == 3.0
    assert np.isnan(small.z_um).sum() == 5
    assert small.origin[0, 0] == 0


# ---------------------------------------------------------------- overlaps


def with_overlap(z: np.ndarray, overlap: np.ndarray | None) -> HeightMap:
    return dataclasses.replace(height_map(z), overlap_um=overlap)


def test_a_difference_is_coloured_where_fields_overlap_and_the_rest_is_grey():
    overlap = np.full((40, 60), np.nan, np.float32)
    overlap[:, 20:30], overlap[:, 30:40] = 0.0, 0.5
    z = np.zeros((40, 60), np.float32)
    z[:, 55:] = np.nan
    picture = bake(with_overlap(z, overlap), DisplayStyle("overlap", "mako", 0.0, 0.5, hillshade=0.0), Light())
    ends = table("mako")[[0, 255]]
    assert (picture[:, 20:30, :3] == ends[0]).all()
    assert (picture[:, 30:40, :3] == ends[1]).all()
    assert (picture[:, 45:55, :3] == np.array(ELSEWHERE)).all()
    assert (picture[:, 45:55, 3] == 255).all()
    assert (picture[:, 55:, 3] == 0).all()


def test_an_uncertainty_is_coloured_expanded_and_grey_where_it_is_not_known():
    u_um = np.full((40, 60), np.nan, np.float32)
    u_um[:, 20:30], u_um[:, 30:40] = 0.0, 0.25
    surface = dataclasses.replace(height_map(np.zeros((40, 60))), u_um=u_um)
    picture = bake(surface, DisplayStyle("uncertainty", "cividis", 0.0, 0.5, hillshade=0.0), Light())
    assert picture[5, 25, :3].tolist() == table("cividis")[0].tolist()
    assert picture[5, 35, :3].tolist() == table("cividis")[255].tolist()
    assert picture[5, 5, :3].tolist() == list(ELSEWHERE)
    assert (picture[..., 3] == 255).all()
    half = reduced(surface, 2).u_um
    assert half is not None
    assert half[3, 17] == pytest.approx(0.25)
    assert np.isnan(half[3, 2])


def test_a_coarser_map_keeps_what_is_known_of_overlaps():
    overlap = np.full((8, 8), np.nan, np.float32)
    overlap[:, :3] = 0.4
    half = reduced(with_overlap(np.zeros((8, 8)), overlap), 2)
    assert half.overlap_um is not None
    assert np.isfinite(half.overlap_um[0]).tolist() == [True, True, False, False]
    assert half.overlap_um[:, :2] == pytest.approx(0.4)
    assert reduced(with_overlap(np.zeros((8, 8)), None), 2).overlap_um is None


def test_words_in_one_picture_are_each_found_again():
    tags = [tag(str(n), (255, 255, 255), (10, 20, 30)) for n in range(1, 60)]
    picture, uv = text_atlas(tags)
    height, width = picture.shape[:2]
    for word, (u0, v0, u1, v1) in zip(tags, uv.tolist(), strict=True):
        part = picture[round(v0 * height) : round(v1 * height), round(u0 * width) : round(u1 * width)]
        assert np.array_equal(part, word)


def test_plates_lie_where_they_are_put_with_their_tops_at_the_larger_y():
    boxes = np.array([[0.0, 0.0, 2.0, 1.0], [5.0, 5.0, 6.0, 7.0]])
    made = plates(boxes, np.array([0.1, 0.4]), np.array([[0, 0, 0.5, 1], [0.5, 0, 1, 1]], np.float32))
    assert made.triangles.shape == (4, 3)
    first, second = made.vertices[:4], made.vertices[4:]
    assert first[:, 2] == pytest.approx(0.1)
    assert second.min(axis=0).tolist() == pytest.approx([5.0, 5.0, 0.4])
    top = made.vertices[:, 1] == np.repeat([1.0, 7.0], 4)
    assert (made.uv[top, 1] == 0).all()
    across, along = (made.vertices[made.triangles[:, k]] - made.vertices[made.triangles[:, 0]] for k in (1, 2))
    assert (np.cross(across, along)[:, 2] > 0).all()
