"""Heights in focus that are predicted between the places of a coarse look, with an interval that holds them."""

from __future__ import annotations

import numpy as np
import pytest

from wafer_viewer.acquire.focus.coarse_look import spread
from wafer_viewer.acquire.focus.surface import part_centres, predicted_ranges
from wafer_viewer.model.acquisition.plan import FocusCell, FocusPlace
from wafer_viewer.model.errors import RigError

FIELD_UM, U_UM = (670.0, 500.0), 1.2


def smooth_form(seed: int):
    """Tilt, bow and waves, of another size for every seed, and the half width of the area."""
    rng = np.random.default_rng(seed)
    half_um = rng.choice([4_000.0, 30_000.0, 100_000.0])
    tilt, bow = rng.normal(0, 1.5e-3, 2), rng.normal(0, 150) * half_um / 100_000
    waves = [(rng.normal(0, 4), *rng.normal(0, 1.5, 2) / half_um, rng.uniform(0, 6)) for _ in range(3)]

    def form(x, y):
        z = tilt[0] * x + tilt[1] * y + bow * (x**2 + y**2) / half_um**2
        return z + sum(a * np.sin(kx * x + ky * y + phase) for a, kx, ky, phase in waves)

    return form, half_um


def place(number: int, at_um, form, relief_um: float, rng=None) -> FocusPlace:
    """A field as a coarse look finds it; exactly without a generator."""
    cells = []
    for x, y in at_um + part_centres(*FIELD_UM):
        noise = rng.normal(0, U_UM, 2) if rng is not None else (0.0, 0.0)
        cells.append(FocusCell(x, y, form(x, y) + noise[0], form(x, y) + relief_um + noise[1]))
    return FocusPlace(field=number, x_um=at_um[0], y_um=at_um[1], cells=tuple(cells), u_um=U_UM)


def lattice(n: int, half_um: float):
    at = np.linspace(-half_um, half_um, n)
    return np.array([(x, y) for y in at for x in at])


@pytest.mark.slow
@pytest.mark.parametrize("n_places", [9, 16])
def test_twice_the_uncertainty_holds_the_heights_of_unseen_fields(n_places):
    held = []
    for seed in range(1000, 1006):
        form, half_um = smooth_form(seed)
        at, rng = lattice(9, half_um), np.random.default_rng(seed)
        chosen = spread(at, n_places)
        looked = [place(i, at[i], form, 30.0, rng) for i in chosen]
        low, high = predicted_ranges(looked, *at.T, FIELD_UM).reach(2)
        for i in set(range(len(at))) - set(chosen):
            truth = place(i, at[i], form, 30.0)
            held.append(low[i] <= truth.low_um and truth.high_um <= high[i])
    assert np.mean(held) > 0.93


def test_the_prediction_is_worth_less_far_from_the_places_that_were_looked_at():
    form, half_um = smooth_form(1003)
    at, rng = lattice(7, half_um), np.random.default_rng(1)
    near = [i for i, (x, _) in enumerate(at) if x <= 0][::2]
    found = predicted_ranges([place(i, at[i], form, 0.0, rng) for i in near], *at.T, FIELD_UM)
    assert found.u_low_um[at[:, 0] == half_um].min() > 2 * found.u_low_um[near].max()


def test_at_a_step_the_window_is_as_long_as_the_step_and_short_away_from_it():
    def blocks(x, y):
        return 400.0 * (x < 0)

    at, rng = lattice(9, 1350.0), np.random.default_rng(2)
    looked = [place(i, at[i], blocks, 0.0, rng) for i in spread(at, 13)]
    low, high = predicted_ranges(looked, *at.T, FIELD_UM).reach(2)
    length = (high - low).reshape(9, 9)
    assert (length[:, 4] > 395).all()
    assert length[:, [0, 1, 7, 8]].mean() < 60


def test_without_any_focus_there_is_no_prediction():
    blank = FocusPlace(field=1, x_um=0.0, y_um=0.0)
    with pytest.raises(RigError, match="found no focus"):
        predicted_ranges([blank], np.zeros(1), np.zeros(1), FIELD_UM)
