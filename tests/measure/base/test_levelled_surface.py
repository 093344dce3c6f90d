"""Surfaces read from a plane or form laid through themselves."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.surfaces import coordinates, noise_of, surface_of
from wafer_viewer.measure.base import levelled_surface as module
from wafer_viewer.measure.base.height_samples import level_for
from wafer_viewer.measure.base.levelled_surface import Levelled, datum, levelled, levelling_of
from wafer_viewer.measure.tools.step_height import step_height
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.tool_options import Datum, Levelling
from wafer_viewer.model.region import Region

ROWS, COLS = 160, 200
THREE = tuple(Region.point(x, y) for x, y in ((-40.0, -30.0), (40.0, -30.0), (0.0, 35.0)))


def lattice():
    return np.meshgrid(*coordinates(ROWS, COLS))


def tilted(noise_um=0.0, wrong=0.0):
    """z = 0.02 x - 0.01 y + 30; `wrong`: share of points that are off by 25 um."""
    x_um, y_um = lattice()
    z = 0.02 * x_um - 0.01 * y_um + 30 + noise_of(1, x_um.shape, noise_um)
    z[np.random.default_rng(2).random(z.shape) < wrong] += 25
    return surface_of(z)


def bowed():
    """A form of second order."""
    x_um, y_um = lattice()
    return surface_of(1e-3 * x_um**2 - 5e-4 * x_um * y_um + 2e-3 * y_um**2 + 0.01 * x_um - 3)


@pytest.mark.parametrize(
    "levelling",
    [
        Levelling(by="plane"),
        Levelling(by="form", order=1),
        Levelling(by="form"),
        Levelling(by="three points", places=THREE),
        Levelling(by="region", places=(Region.circle(10, 10, 15),)),
    ],
    ids=lambda levelling: levelling.by,
)
def test_a_tilted_plane_is_flat_from_every_zero(levelling):
    flat = levelled(tilted(noise_um=0.01, wrong=0.02), levelling)
    z_um = flat.window().z_raw_um
    assert abs(np.median(z_um)) < 0.02
    assert np.median(np.abs(z_um)) < 0.02, "what is wrong in two of a hundred points does not tilt it"
    assert levelling_of(flat) == levelling


@pytest.mark.parametrize(("order", "left_um"), [(1, 5.0), (2, 1e-4), (3, 1e-4)])
def test_a_form_takes_as_much_of_a_bow_as_its_order_can(order, left_um):
    flat = levelled(bowed(), Levelling(by="form", order=order))
    assert np.ptp(flat.window().z_um) == pytest.approx(left_um, abs=left_um)


def test_the_stage_levels_nothing():
    surface = tilted()
    assert levelled(surface, Levelling()) is surface
    assert datum(surface, Levelling()) == Datum()
    assert Levelled(surface, Datum()).window() is surface
    assert levelling_of(surface) == Levelling()


def test_a_window_is_levelled_as_the_whole_is():
    surface = tilted(noise_um=0.1)
    flat = levelled(surface, Levelling(by="plane"))
    assert (flat.shape, flat.levels, flat.pixel_um) == (surface.shape, 1, surface.pixel_um)
    assert (flat.x0_um, flat.y0_um, flat.provenance) == (surface.x0_um, surface.y0_um, surface.provenance)
    part, full = flat.window(Region.rectangle(-10, -20, 10, 5)), flat.window()
    row, col = (int(a[0]) for a in np.nonzero(full.z_um == part.z_um[0, 0]))
    rows, cols = part.shape
    np.testing.assert_array_equal(part.z_um, full.z_um[row : row + rows, col : col + cols])
    np.testing.assert_array_equal(part.origin, surface.origin[row : row + rows, col : col + cols])
    assert surface.z_um[0, 0] != full.z_um[0, 0], "the surface itself stays as it is"


def test_what_is_unmeasured_stays_so():
    surface = tilted()
    surface.z_um[5, 5] = surface.z_raw_um[5, 5] = np.nan
    part = levelled(surface, Levelling(by="plane")).window()
    assert np.isnan(part.z_um[5, 5])
    assert np.count_nonzero(np.isnan(part.z_um)) == 1


def test_a_step_is_the_same_from_any_plane():
    x_um, _ = lattice()
    surface = surface_of(0.01 * x_um + np.where(x_um < 0, 12.0, 0.0))
    upper, lower = Region.rectangle(-40, -30, -5, 30), Region.rectangle(5, -30, 40, 30)
    flat = levelled(surface, Levelling(by="region", places=(lower,)))
    found = step_height(flat, upper, lower)
    assert found.height.value_um == pytest.approx(12.0, abs=1e-3)
    assert found.lower_mean_um == pytest.approx(0.0, abs=1e-3)
    assert found.levelling.by == "region"


def test_a_large_surface_is_fitted_to_some_of_its_points(monkeypatch):
    """Neither a plain map nor a mosaic is fitted at its full size."""
    monkeypatch.setattr(module, "FITTED_PIXELS", 2000)
    surface = tilted()
    sizes: list[int] = []
    fit = module.robust_fit
    monkeypatch.setattr(module, "robust_fit", lambda design, z: (sizes.append(len(z)), fit(design, z))[1])
    found = datum(surface, Levelling(by="plane"))
    assert sizes[0] <= 2000
    at = found.at(np.array(20.0), np.array(-10.0))
    assert float(at) == pytest.approx(30.5, abs=1e-3)


def test_a_mosaic_is_fitted_at_a_coarse_level(monkeypatch):
    monkeypatch.setattr(module, "FITTED_PIXELS", ROWS * COLS // 4)
    requested: list[int] = []
    fine, half = tilted(), tilted()

    class Pyramid:
        levels = 3

        def __getattr__(self, name):
            return getattr(fine, name)

        def window(self, region=None, level=0):
            requested.append(level)
            return half

    datum(Pyramid(), Levelling(by="form"))
    assert requested == [1]
    assert level_for(fine, Region.rectangle(-5, -5, 5, 5)) == 0


@pytest.mark.parametrize(
    ("levelling", "sentence"),
    [
        (Levelling(by="three points", places=(THREE[0], THREE[0], THREE[1])), "lie on a line"),
        (Levelling(by="three points", places=(Region.point(900, 0), *THREE[1:])), "lies outside of the surface"),
        (
            Levelling(by="three points", places=(Region.point(0, 0), *THREE[1:])),
            r"Nothing was measured round \(0",
        ),
        (Levelling(by="region", places=(Region.line(0, 0, 5, 5),)), "is a line and has no area"),
        (Levelling(by="region", places=(Region.rectangle(-3, -3, 3, 3),)), "Nothing was measured where"),
    ],
)
def test_a_zero_that_cannot_be_found_is_one_sentence(levelling, sentence):
    surface = tilted()
    surface.z_raw_um[65:95, 85:115] = np.nan
    with pytest.raises(MeasureError, match=sentence):
        datum(surface, levelling)


def test_a_way_of_levelling_asks_for_its_places():
    with pytest.raises(MeasureError, match="3 places to level by three points"):
        Levelling(by="three points", places=THREE[:2])
    with pytest.raises(MeasureError, match="between 1 and 4"):
        Levelling(by="form", order=7)


def test_one_layer_alone_is_levelled_as_a_window_is():
    surface = Levelled(surface_of(slope := np.add.outer(np.arange(60) * 0.1, np.arange(80) * 0.3)), TILTED)
    region = Region.rectangle(-8, -6, 9, 7)
    part = surface.window(region)
    alone = surface.one_layer("filled", region)
    np.testing.assert_allclose(alone.z_um, part.z_um, atol=1e-5)
    assert (alone.x0_um, alone.y0_um) == (part.x0_um, part.y0_um)
    assert not np.allclose(alone.z_um, slope[: alone.z_um.shape[0], : alone.z_um.shape[1]])


TILTED = Datum(powers=((1, 0), (0, 1)), coefficients=(0.2, -0.1))
