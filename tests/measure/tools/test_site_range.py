"""What one side of a wafer shows, under its own name; what it cannot show is refused with the reason."""

from __future__ import annotations

import json

import numpy as np
import pytest

from tests.support.surfaces import PIXEL_UM, calibration, coordinates, surface_of
from wafer_viewer.cli.app import main
from wafer_viewer.measure.tools.site_range import REFUSED, site_ranges
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.region import Region
from wafer_viewer.store.formats.npz_file import write_npz

SHAPE = 200, 300
SITE_UM = 100 * PIXEL_UM


def stepped() -> np.ndarray:
    """A tilted plane; in the site at the upper right a bump of 3 um, in the lower middle most is unmeasured."""
    x_um, y_um = np.meshgrid(*coordinates(*SHAPE))
    z = 0.02 * x_um + 0.01 * y_um
    z[40:44, 240:244] += 3.0
    z[110:200, 105:195] = np.nan
    return z


def test_each_site_has_its_range_about_its_own_plane():
    found = site_ranges(surface_of(stepped(), calibration=calibration()), (SITE_UM, SITE_UM))
    assert (found.rows, found.cols, len(found.sites)) == (2, 3, 6)
    assert [site.range is None for site in found.sites] == [False, False, False, False, True, False]
    ranges = [site.range.value_um for site in found.sites if site.range is not None]
    assert ranges[2] == pytest.approx(3.0, rel=0.03)
    assert max(ranges[:2] + ranges[3:]) < 1e-3
    assert found.largest.value_um == ranges[2]
    assert {site.range.status for site in found.sites if site.range is not None} == {"evaluated"}
    assert found.sites[0].x_um < found.sites[1].x_um
    assert found.sites[0].y_um > found.sites[3].y_um
    assert any("as mounted" in note for note in found.notes)
    assert any("1 site with less" in note for note in found.notes)


@pytest.mark.slow
def test_u_covers_what_noise_adds_to_the_range_of_a_site():
    x_um, y_um = np.meshgrid(*coordinates(100, 100))
    bowl = 4e-4 * ((x_um - x_um.mean()) ** 2 + (y_um - y_um.mean()) ** 2)
    flat = site_ranges(surface_of(bowl, calibration=calibration()), (SITE_UM, SITE_UM)).largest.value_um
    covered = []
    for seed in range(20):
        noisy = bowl + np.random.default_rng(seed).normal(0, 0.02, bowl.shape)
        found = site_ranges(surface_of(noisy, calibration=calibration()), (SITE_UM, SITE_UM)).largest
        covered.append(0.25 * found.expanded_um < abs(found.value_um - flat) < found.expanded_um)
    assert sum(covered) >= 18


def test_of_very_many_sites_the_largest_alone_has_u():
    z_um = np.random.default_rng(1).normal(0, 0.02, (330, 330))
    side_um = 15 * PIXEL_UM
    found = site_ranges(surface_of(z_um, calibration=calibration()), (side_um, side_um))
    assert len(found.sites) > 400
    assert {site.range.status for site in found.sites} == {"not evaluated"}
    assert found.largest.status == "evaluated"
    assert "Of more than 400 sites the largest range alone has U." in found.notes


@pytest.mark.parametrize(
    ("site_um", "region", "message"),
    [
        ((1e4, 1e4), None, "no site of 10000 x 10000 um"),
        ((0.0, 10.0), None, "no area"),
        ((0.1, 0.1), None, "more than 10000"),
        ((10.0, 10.0), Region.rectangle(0, -48, 22, -26), "None of 4 sites"),
    ],
)
def test_sites_that_cannot_be_are_refused(site_um, region, message):
    z = np.full(SHAPE, np.nan)
    with pytest.raises(MeasureError, match=message):
        site_ranges(surface_of(z), site_um, region)


def test_the_share_done_is_told_and_a_stop_is_heard():
    shares: list[float] = []
    surface = surface_of(stepped(), calibration=calibration())
    site_ranges(surface, (SITE_UM, SITE_UM), progress=shares.append)
    assert shares == sorted(shares)
    assert (shares[0], shares[-1], len(shares)) == (0.0, 1.0, 13)
    with pytest.raises(MeasureError, match="was stopped"):
        site_ranges(surface, (SITE_UM, SITE_UM), should_stop=lambda: len(shares) > 0)


def test_from_the_command_line(tmp_path, capsys: pytest.CaptureFixture[str]):
    path = tmp_path / "wafer.npz"
    write_npz(surface_of(stepped(), calibration=calibration()), path)
    assert main(["measure", "site-range", str(path), "--site", str(SITE_UM), str(SITE_UM)]) == 0
    reported = json.loads(capsys.readouterr().out)
    assert reported["largest"]["value_um"] == pytest.approx(3.0, rel=0.03)


@pytest.mark.parametrize("term", ["TTV", *REFUSED])
def test_what_needs_two_sides_is_refused_with_the_reason(term, capsys: pytest.CaptureFixture[str]):
    assert main(["measure", term, "wafer.npz"]) == 2
    reported = capsys.readouterr()
    assert reported.out == ""
    assert reported.err.count("\n") == 1
    assert "front side" in reported.err
    assert "site-range" in reported.err
