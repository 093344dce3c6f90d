"""Signatures by planted truth: groups among defects at random, and no more of them than the level on random wafers."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy import stats

from wafer_viewer.measure.defects.signatures import signatures
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.inspection.die_grid import DieGrid, DieStatus
from wafer_viewer.model.inspection.lot import DefectSignature, WaferDefect, WaferDefects
from wafer_viewer.model.region import Point
from wafer_viewer.model.spec import replace

GRID = DieGrid(
    pitch_x_um=5000.0,
    pitch_y_um=4000.0,
    width_um=4900.0,
    height_um=3900.0,
    x0_um=-50_000.0,
    y0_um=-50_000.0,
    cols=20,
    rows=25,
)
pytestmark = pytest.mark.slow
RADIUS_UM = 50_000.0
N_RANDOM = 200


@cache
def dies(grid: DieGrid = GRID) -> tuple[DieStatus, ...]:
    """The dies that lie wholly on a round wafer."""

    def is_on(col: int, row: int) -> bool:
        x, y = GRID.to_stage(col, row, np.array([0, 4900, 0, 4900]), np.array([0, 0, 3900, 3900]))
        return bool(np.hypot(x, y).max() <= RADIUS_UM)

    return tuple(
        DieStatus(name=grid.name(*at), col=at[0], row=at[1], state="whole", measured_fraction=1.0, defects=0)
        for at in grid.places
        if is_on(*at)
    )


def at_random(n: int, rng: np.random.Generator, on: tuple[DieStatus, ...]) -> np.ndarray:
    chosen = [on[k] for k in rng.integers(len(on), size=n)]
    cols, rows = np.array([(die.col, die.row) for die in chosen]).T
    return np.column_stack(GRID.to_stage(cols, rows, rng.uniform(0, 4900, n), rng.uniform(0, 3900, n)))


def wafer(xy_um: np.ndarray, on: tuple[DieStatus, ...] | None = None, grid: DieGrid = GRID) -> WaferDefects:
    defects = tuple(
        WaferDefect(number=k, kind="Particle", x_um=x, y_um=y) for k, (x, y) in enumerate(xy_um.tolist(), 1)
    )
    return WaferDefects(name="w", grid=grid, dies=dies() if on is None else on, defects=defects, inspected_mm2=5000.0)


def with_planted(seed: int, planted: np.ndarray) -> WaferDefects:
    """Random defects, then those planted, which have the numbers above `N_RANDOM`."""
    return wafer(np.concatenate((at_random(N_RANDOM, np.random.default_rng(seed), dies()), planted)))


def hits(found: DefectSignature) -> tuple[int, int]:
    """Return how many planted and how many other defects a signature has."""
    planted = sum(number > N_RANDOM for number in found.numbers)
    return planted, len(found.numbers) - planted


@pytest.mark.campaign
@pytest.mark.parametrize("part", ["whole wafer", "quarter"])
def test_random_wafers_have_no_more_signatures_than_the_level(part: str):
    on = dies() if part == "whole wafer" else tuple(die for die in dies() if die.col < 10 and die.row < 12)
    rng = np.random.default_rng(1041 if part == "quarter" else 1042)
    wafers = [wafer(at_random(int(rng.integers(20, 80)), rng, on), on) for _ in range(50)]
    named = sum(bool(signatures(one, level=0.1, seed=k)) for k, one in enumerate(wafers))
    assert named <= stats.binom.ppf(0.995, 50, 0.1)


@pytest.mark.parametrize("seed", [1051, 1052, 1053])
def test_a_planted_cluster_is_found_with_its_place(seed: int):
    rng = np.random.default_rng(seed)
    middle = rng.uniform(-25_000, 25_000, 2)
    (found,) = signatures(with_planted(seed, rng.normal(0, 400, (14, 2)) + middle))
    planted, others = hits(found)
    assert (found.kind, planted >= 12, others <= 3) == ("cluster", True, True)
    assert (found.center.x_um, found.center.y_um) == pytest.approx(middle.tolist(), abs=800)
    assert found.by_chance <= 0.005


@pytest.mark.parametrize("seed", [1061, 1062, 1063])
def test_a_planted_scratch_is_named_with_its_direction(seed: int):
    rng = np.random.default_rng(seed)
    angle, along = rng.uniform(0, np.pi), np.linspace(-9000, 9000, 18)[:, None]
    line = along * [np.cos(angle), np.sin(angle)] + rng.normal(0, 80, (18, 2)) + rng.uniform(-15_000, 15_000, 2)
    found = signatures(with_planted(seed, line))[0]
    assert (found.kind, hits(found)[0] >= 14) == ("scratch", True)
    assert abs((found.angle_deg - np.degrees(angle) + 90) % 180 - 90) < 5
    assert found.length_um > 4 * found.width_um


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize(
    ("kind", "radii_um"), [("ring", (22_000, 24_000)), ("edge", (45_000, 50_000)), ("center", (0, 15_000))]
)
def test_planted_rings_are_named_by_their_radius(kind: str, radii_um: tuple[float, float]):
    rng = np.random.default_rng(1071)
    xy = at_random(20_000, rng, dies())
    in_ring = xy[(np.hypot(*xy.T) >= radii_um[0]) & (np.hypot(*xy.T) < radii_um[1])][:60]
    found = next(one for one in signatures(with_planted(1072, in_ring)) if one.expected is not None)
    assert found.kind == kind
    assert hits(found)[0] >= 40
    assert len(found.numbers) > 2 * (found.expected or 0.0)


def test_a_cluster_counts_once_for_a_ring_and_a_ring_is_no_cluster():
    rng = np.random.default_rng(1081)
    (cluster,) = signatures(with_planted(1082, rng.normal([20_000, 5000], 300, (40, 2))))
    assert cluster.kind == "cluster"
    xy = at_random(20_000, rng, dies())
    found = signatures(with_planted(1083, xy[np.hypot(*xy.T) > 44_000][:120]))
    assert [one.kind for one in found] == ["edge"]


def test_places_follow_a_turned_lattice_and_the_same_seed_gives_the_same():
    rng = np.random.default_rng(1091)
    straight = with_planted(1092, rng.normal([9000, -4000], 300, (14, 2)))
    c, s = np.cos(0.3), np.sin(0.3)
    turned_grid = replace(GRID, angle_rad=0.3, x0_um=c * -50_000 - s * -50_000, y0_um=s * -50_000 + c * -50_000)
    xy = np.array([(d.x_um, d.y_um) for d in straight.defects]) @ np.array([[c, s], [-s, c]])
    (one,), (other,) = signatures(straight), signatures(wafer(xy, grid=turned_grid))
    assert one == signatures(straight)[0]
    assert (one.numbers, one.by_chance) == (other.numbers, other.by_chance)
    x, y = one.center.x_um, one.center.y_um
    assert (other.center.x_um, other.center.y_um) == pytest.approx((c * x - s * y, s * x + c * y), abs=1.0)


def test_few_defects_have_no_signature_and_an_unknown_area_is_refused():
    assert signatures(wafer(np.zeros((4, 2)))) == ()
    with pytest.raises(MeasureError, match="no completely inspected die"):
        signatures(wafer(np.zeros((9, 2)), ()))
    with pytest.raises(MeasureError, match="level is 0"):
        signatures(wafer(np.zeros((9, 2))), level=0.0)


def test_defects_on_dies_that_were_partly_scanned_do_not_count():
    rng = np.random.default_rng(1101)
    planted = with_planted(1102, rng.uniform(2000, 2300, (20, 2)))
    col, row, _, _ = (int(part[0]) for part in GRID.to_die(np.array([2100.0]), np.array([2100.0])))
    cut = tuple(replace(die, state="partly scanned") if die.name == f"{col},{row}" else die for die in dies())
    assert signatures(planted)
    assert signatures(replace(planted, dies=cut, center=Point(x_um=0.0, y_um=0.0))) == ()
