"""Budgets held against the propagation of distributions by simulation (JCGM 101)."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import norm, qmc

from tests.bench.bench_coverage import WINDOW_PX, bump, groove, roof, step
from tests.support.surfaces import PIXEL_UM, calibration, noise_of, surface_of
from wafer_viewer.measure.base.measurement_context import INTERPOLATION, WINDOW
from wafer_viewer.model.quantity import Length
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.recipe import Recipe

DRAWS, SCALE, NOISE_UM = 256, 3e-4, 0.1
NOT_DRAWN = (WINDOW, INTERPOLATION)
"""Lines without a source in the simulation: there is neither a focus window nor a frame."""


@dataclass(frozen=True)
class Draw:
    """The same sample every time, with its own noise, z scale and pixel size."""

    seed: int
    scales: tuple[float, float]

    @property
    def rng(self) -> np.random.Generator:
        return np.random.default_rng(5)

    def measured(self, z_um):
        z_scale, pixel_scale = self.scales
        noisy = z_um * z_scale + noise_of((self.seed, 7), z_um.shape, NOISE_UM)
        known = replace(calibration(SCALE), u_pixel_um=SCALE * PIXEL_UM)
        surface = surface_of(noisy, calibration=known, recipe=Recipe(window=WINDOW_PX), z_step_um=0.0)
        sizes = {name: getattr(surface, name) * pixel_scale for name in ("pixel_um", "x0_um", "y0_um")}
        return dataclasses.replace(surface, **sizes)


@pytest.mark.slow
@pytest.mark.campaign
@pytest.mark.parametrize(
    ("sample", "names"),
    [(step, ["step"]), (groove, ["groove"]), (roof, ["angle"]), (bump, ["radius", "top", "volume"])],
)
def test_the_budget_is_what_a_simulation_of_its_sources_scatters(sample, names):
    scales = 1 + SCALE * norm.ppf(qmc.Sobol(2, seed=1).random(DRAWS))
    values, variances = {name: [] for name in names}, {name: [] for name in names}
    for seed, drawn in enumerate(scales):
        for name, _, found in sample(Draw(seed, tuple(drawn))):
            quantity = found.quantity if isinstance(found, Length) else found
            values[name].append(quantity.value)
            variances[name].append(sum(line.u**2 for line in quantity.budget if line.name not in NOT_DRAWN))
    for name in names:
        ratio = np.sqrt(np.mean(variances[name])) / np.std(values[name], ddof=1)
        assert 0.9 < ratio < 1.15, name  # the deviation of so many draws is known to 4.4 %
