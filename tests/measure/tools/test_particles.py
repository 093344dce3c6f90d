"""Particles and grains: number, sizes, heights and volumes of drawn caps, what is cut, and grains that touch."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.surfaces import PIXEL_UM, calibration, coordinates, surface_of
from wafer_viewer.cli.app import main
from wafer_viewer.measure.tools.particles import particles
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.findings import MeasurementResults
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.store.formats.npz_file import write_npz
from wafer_viewer.store.tables.csv_tables import findings_csv

SHAPE = 200, 300
X, Y = coordinates(*SHAPE)
FACE = Region.rectangle(X[0], Y[-1], X[-1], Y[0])


def place(col, row):
    return X[col], Y[row]


def face(*caps, noise_um=0.01):
    """Return a tilted face with discs (col, row, radius in px, height in um)."""
    x_um, y_um = np.meshgrid(X, Y)
    z_um = 0.01 * x_um + np.random.default_rng(4).normal(0, noise_um, SHAPE)
    for col, row, radius_px, height_um in caps:
        x0, y0 = place(col, row)
        z_um[np.hypot(x_um - x0, y_um - y0) <= radius_px * PIXEL_UM] += height_um
    return surface_of(z_um, calibration=calibration())


def test_number_place_size_height_and_volume_of_discs():
    found = particles(face((60, 60, 12, 2.0), (150, 100, 20, 3.0), (240, 150, 8, 1.0)), FACE)
    assert (found.n_particles, found.n_cut) == (3, 0)
    largest = found.particles[0]
    assert (largest.place.x_um, largest.place.y_um) == pytest.approx(place(150, 100), abs=PIXEL_UM / 2)
    assert largest.diameter_um == pytest.approx(40 * PIXEL_UM, rel=0.02)
    assert largest.longest_um == pytest.approx(41 * PIXEL_UM, rel=0.03)
    assert largest.height_um == pytest.approx(3.0, abs=0.06)
    assert largest.volume_um3 == pytest.approx(3.0 * np.pi * (20 * PIXEL_UM) ** 2, rel=0.02)
    assert largest.circularity > 0.95
    assert found.mean_diameter.value_um == pytest.approx(80 / 3 * PIXEL_UM, rel=0.03)
    assert found.density_per_mm2 == pytest.approx(3e6 / (SHAPE[0] * SHAPE[1] * PIXEL_UM**2), rel=0.01)


def test_what_is_cut_small_or_beside_unmeasured_places_is_left_out():
    surface = face((0, 100, 15, 2.0), (60, 60, 2, 2.0), (150, 100, 20, 3.0), (240, 150, 12, 1.0))
    z_um = surface.z_raw_um.copy()
    z_um[150:160, 250:260] = np.nan
    found = particles(replace(surface, z_um=z_um, z_raw_um=z_um), FACE, least_um=9 * PIXEL_UM)
    assert (found.n_particles, found.n_cut) == (1, 2)
    assert particles(surface, FACE, least_um=PIXEL_UM).n_particles == 3


def test_grains_that_touch_are_parted_by_their_tops():
    x_um, y_um = np.meshgrid(X, Y)
    z_um = np.zeros(SHAPE)
    for col in (100, 130):
        x0, y0 = place(col, 100)
        z_um = np.maximum(z_um, 3 - (np.hypot(x_um - x0, y_um - y0) / (12 * PIXEL_UM)) ** 2)
    z_um = np.maximum(z_um, 0) + np.random.default_rng(1).normal(0, 0.01, SHAPE)
    surface = surface_of(z_um, calibration=calibration())
    assert particles(surface, FACE, over_um=0.3).n_particles == 1
    parted = particles(surface, FACE, over_um=0.3, split="tops")
    assert sorted(round((p.place.x_um - X[0]) / PIXEL_UM) for p in parted.particles) == pytest.approx([100, 130], abs=2)


def test_pits_are_found_below_and_a_mask_leaves_them_out():
    surface = face((60, 60, 12, -2.0), (200, 120, 12, -1.0))
    assert particles(surface, FACE, stand="below").n_particles == 2
    with pytest.raises(MeasureError, match="No whole particle of"):
        particles(surface, FACE)
    masked = FACE.without(Region.circle(*place(60, 60), 20 * PIXEL_UM))
    assert particles(surface, masked, stand="below").n_particles == 1


def test_the_table_has_every_particle(tmp_path, capsys):
    surface = face((60, 60, 12, 2.0), (150, 100, 20, 3.0))
    text = findings_csv(MeasurementResults(items=(replace(particles(surface, FACE), number=1, name="dust"),)))
    assert "particle 2 diameter" in text
    write_npz(surface, tmp_path / "dust.npz")
    corners = [str(n) for n in (X[0], Y[-1], X[-1], Y[0])]
    assert main(["measure", "particles", str(tmp_path / "dust.npz"), "--region", *corners, "--split", "tops"]) == 0
    assert '"n_particles": 2' in capsys.readouterr().out
