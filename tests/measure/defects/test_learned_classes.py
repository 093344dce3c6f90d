"""Classes proposed from judged defects: right on those that nobody judged, and never in place of a judgement."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from tests.support.datasets.inspections import defect, inspection
from tests.support.surfaces import height_map
from wafer_viewer.measure.defects.learned_classes import FEATURES, judged_defects, of_others, with_learned_classes
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.inspection.defect import Defect, Inspection
from wafer_viewer.model.inspection.learned_classes import NUISANCE, JudgedDefects
from wafer_viewer.model.quantity import Length, Quantity
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import HeightMap

KINDS = ("bridge", "residue", NUISANCE)
"""What people say: a steep ridge, a gentle bump, and a stain that only the picture shows."""
PITCH_PX, ACROSS = 40, 8


def made(seed: int) -> tuple[HeightMap, Inspection]:
    """A surface with 64 defects, all of which the rules take for particles; their names are what they are."""
    dice = np.random.default_rng(seed)
    side = ACROSS * PITCH_PX
    y, x = np.indices((side, side)).astype(np.float64)
    z = dice.normal(0.0, 0.05, (side, side))
    grey = dice.normal(120.0, 6.0, (side, side))
    found: list[Defect] = []
    for number in range(1, ACROSS**2 + 1):
        row, col = divmod(number - 1, ACROSS)
        kind = KINDS[number % 3]
        size = dice.uniform(8, 13)
        off_x, off_y = (np.asarray(axis - (at + 0.5) * PITCH_PX) for axis, at in ((x, col), (y, row)))
        away = np.hypot(off_x, off_y) / (size / 2)
        if kind == "bridge":
            z += 2.0 * (away < 1)
        elif kind == "residue":
            z += 2.0 * np.exp(-2 * away**2)
        grey[away < 1] += 40 if kind == NUISANCE else 10
        found.append(_defect(number, kind, (col + 0.5) * PITCH_PX, -(row + 0.5) * PITCH_PX, size, dice))
    surface = height_map(z.astype(np.float32), 1.0, grey=np.clip(grey, 0, 255).astype(np.uint8))
    return surface, inspection(*found, grid=None, dies=())


def _defect(number: int, name: str, x: float, y: float, size: float, dice: np.random.Generator) -> Defect:
    length = Length(value_um=size * dice.uniform(0.9, 1.1))
    return replace(
        defect(number, "0,0", 0.0, 0.0),
        name=name,
        center=Point(x_um=x, y_um=y),
        outline=Region.circle(x, y, size / 2),
        die="",
        in_die=None,
        major=length,
        minor=length,
        area=Quantity(value=np.pi / 4 * size**2, unit="um2"),
        height=Length(value_um=2.0),
    )


def judged(found: Inspection, most: int) -> Inspection:
    """The first so many, judged as what they are."""

    def says(one: Defect) -> Defect:
        if one.number > most:
            return one
        if one.name == NUISANCE:
            return replace(one, judgement="nuisance")
        return replace(one, judgement="real", judged_kind=one.name)

    return replace(found, defects=tuple(map(says, found.defects)))


def right(found: Inspection) -> float:
    """Share of the open ones for which the right class is proposed."""
    return float(np.mean([d.learned.kind == d.name for d in found.defects if d.learned is not None]))


@pytest.mark.slow
def test_classes_that_no_rule_knows_are_proposed_right_after_few_judgements():
    surface, found = made(1)
    before = judged(found, 24)
    after = with_learned_classes(before, surface)
    assert right(after) >= 0.9
    assert [d.number for d in after.defects if d.learned is None] == list(range(1, 25)), "judged ones stay alone"
    assert [replace(d, learned=None) for d in after.defects] == list(before.defects), "nothing is overruled"
    assert after.learned is not None
    assert (after.learned.judged, after.learned.wafers) == (24, 1)
    assert after.learned.right_fraction >= 0.85
    assert after.learned.rules_right_fraction == 0.0
    assert with_learned_classes(before, surface) == after, "the same every time"


@pytest.mark.slow
def test_the_judgements_of_another_wafer_serve_the_next_one():
    first_surface, first = made(2)
    learned_from = judged_defects(judged(first, 30), first_surface, wafer="w1/default")
    surface, found = made(3)
    after = with_learned_classes(found, surface, (learned_from,))
    assert right(after) >= 0.9
    assert len([d for d in after.defects if d.learned is not None]) == len(found.defects)
    assert of_others(learned_from, "w1/default").defects == ()
    assert of_others(learned_from, "w2/default") == learned_from


@pytest.mark.slow
def test_a_share_is_high_where_the_proposal_is_right():
    surface, found = made(4)
    after = with_learned_classes(judged(found, 12), surface)
    shares: dict[bool, list[float]] = {True: [], False: []}
    for one in after.defects:
        if one.learned is not None:
            shares[one.learned.kind == one.name].append(one.learned.share)
    assert all(0.33 <= share <= 1 for share in (*shares[True], *shares[False]))
    assert np.mean(shares[True]) > (np.mean(shares[False]) if shares[False] else 0.6)


def few() -> Any:
    surface, found = made(5)
    return judged(found, 7), surface


def all_alike() -> Any:
    surface, found = made(5)
    return replace(found, defects=tuple(replace(d, judgement="real") for d in found.defects)), surface


@pytest.mark.parametrize("case", [few, all_alike])
def test_too_few_judgements_are_refused_with_how_many_there_are(case: Callable[[], Any]):
    found, surface = case()
    n = sum(one.judgement != "open" for one in found.defects)
    with pytest.raises(MeasureError, match=rf"at least 8 judged defects, not all of one class.*\({n} judged\)"):
        with_learned_classes(found, surface)


def test_numbers_of_another_version_do_not_count():
    surface, found = made(6)
    other = JudgedDefects(features=("length",))
    assert of_others(other, "").features == FEATURES
    stale = judged_defects(judged(found, 30), surface)
    renamed = replace(stale, features=("another", *stale.features[1:]))
    with pytest.raises(MeasureError, match=r"\(0 judged\)"):
        with_learned_classes(found, surface, (renamed,))


def test_without_scikit_learn_the_error_names_the_command(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "sklearn.ensemble", None)
    surface, found = made(7)
    with pytest.raises(MeasureError, match=r"pip install 'wafer-viewer\[learning\]'"):
        with_learned_classes(judged(found, 20), surface)
