"""Plots that surfaces and profiles draw of themselves, with the places and heights that they have."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.figure import Figure

from tests.support.surfaces import surface_of
from wafer_viewer.draw import plots
from wafer_viewer.measure.tools.profile import profile
from wafer_viewer.model.region import Region


@pytest.fixture(autouse=True)
def no_open_figures():
    yield
    pyplot.close("all")


def surface(**provenance):
    z_um = np.add.outer(np.zeros(40), np.linspace(0, 10, 60))
    z_um[:5, :5] = np.nan
    return surface_of(z_um, **provenance)


def test_a_surface_is_drawn_at_its_place_on_the_stage():
    axes = surface().plot()
    (image,) = axes.images
    assert image.get_extent() == pytest.approx((-15, 15, -10, 10))
    assert np.ma.getmaskarray(image.get_array())[:5, :5].all()
    assert image.get_array()[20, 59] == pytest.approx(10)
    assert image.get_clim() == pytest.approx((0, 10), abs=0.2)
    assert (axes.get_xlabel(), axes.get_ylabel(), axes.get_title(loc="right")) == ("x, µm", "y, µm", "")
    assert axes.figure.axes[1].get_ylabel() == "Height, µm"
    assert surface(simulated=True).plot().get_title(loc="right") == "SIMULATED"


def test_a_profile_is_drawn_in_axes_that_are_given():
    axes = Figure().add_subplot()
    _, curve = profile(surface(), Region.line(-14.75, 9.75, 14.75, 9.75))
    assert curve.plot(axes) is axes
    (line,) = axes.lines
    x_um, z_um = line.get_data()
    assert np.isnan(z_um[:5]).all()
    assert z_um[-1] == pytest.approx(10, abs=1e-6)
    assert x_um[-1] == pytest.approx(29.5)


def test_a_large_surface_is_read_at_a_coarser_level(monkeypatch):
    monkeypatch.setattr(plots, "MOST_PX", 30)
    asked = []

    class Pyramid(type(surface())):
        __slots__ = ()

        @property
        def levels(self):
            return 3

        def window(self, region=None, level=0):
            asked.append(level)
            return super().window(region, 0)

    plain = surface()
    Pyramid(**{name: getattr(plain, name) for name in plain.__dataclass_fields__}).plot()
    assert asked == [1]
