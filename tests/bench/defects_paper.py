"""Defects of the virtual rig's own wafer: are the gel drop, the scratch and every particle of 8 px and more found?

The dataset is that of `wafer-viewer paper --keep FOLDER`, FOLDER/wafer.wafer, with its inspection. The true places come
from the scene's own functions (tests/truth/virtual_wafer.py).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tests.bench.harness import met, show
from tests.truth.virtual_wafer import PIXEL_UM, ROOM_UM, Known, chipped_share, ground, known, own_to_the_die
from wafer_viewer.model.inspection.defect import Defect, Inspection
from wafer_viewer.session.reporting.report_data import outline_um
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.records.inspection_records import read_inspection

LEAST_PX, MOST_FALSE = 8, 2
ON_DIES = "die", "die's edge", "trench"


def show_paper(dataset: Path) -> None:
    """The goals, and where what is missed and false lies."""
    stored = Dataset.open(dataset).result()
    found = read_inspection(stored.path)
    if found is None:
        raise SystemExit(f"{dataset} has no inspection.")
    told(outline_um(stored.mosaic()), found)


def told(corners_um: tuple[float, float, float, float], found: Inspection) -> None:
    """What an inspection made of what is known to be between two corners."""
    there = known(*corners_um)
    caught = [one for one in there if any(_touch(one, defect) for defect in found.found)]
    others = [defect for defect in found.found if not any(_touch(one, defect) for one in there)]
    why = Counter(own_to_the_die(defect.center.x_um, defect.center.y_um) for defect in others)
    false = [defect for defect in others if not own_to_the_die(defect.center.x_um, defect.center.y_um)]
    large = [one for one in there if one.kind == "particle" and 2 * one.radius_um >= LEAST_PX * PIXEL_UM]
    rows = [
        (f"particles of {LEAST_PX} px and more, {on}", *_count(caught, [p for p in large if p.on == on]))
        for on in (*ON_DIES, "no die", "tape")
    ]
    on_dies = [one for one in large if one.on in ON_DIES]
    small = [one for one in there if one.kind == "particle" and one not in large and one.on in ON_DIES]
    rows += [
        ("smaller particles on dies and round them", *_count(caught, small)),
        ("gel drop", *_count(caught, [one for one in there if one.kind == "gel"])),
        ("scratch, pieces of 4 um", *_count(caught, [one for one in there if one.kind == "scratch"])),
    ]
    show("The virtual rig's wafer", ("", "found", "of"), rows)
    where = Counter(ground(defect.center.x_um, defect.center.y_um) for defect in false)
    kinds = Counter(defect.kind for defect in false)
    differ = ", ".join(f"{n} at a {reason}" for reason, n in why.items() if reason)
    goal = f"goal {MOST_FALSE} on 36 mm2 {met(len(false), MOST_FALSE)}"
    near = f"{chipped_share(1, 1):.0%} of a die's outline lies within {ROOM_UM:.0f} um of a chip of a pixel or more"
    print(
        f"  inspected {found.inspected_mm2:.1f} mm2, against {found.reference}: {len(found.found)} defects\n"
        f"  {len(false)} false ({goal}): {dict(where)}, {dict(kinds)}\n"
        f"  where dies truly differ: {differ}; {near}\n"
        f"  particles of {LEAST_PX} px and more on dies and round them: {sum(p in caught for p in on_dies)} of "
        f"{len(on_dies)}, goal all {met(sum(p in caught for p in on_dies), len(on_dies), True)}; where no die stands "
        "nothing is compared",
        flush=True,
    )


def _count(caught: Sequence[Known], some: Sequence[Known]) -> tuple[int, int]:
    return sum(one in caught for one in some), len(some)


def _touch(one: Known, defect: Defect) -> bool:
    """Whether a defect's middle lies on it, or it reaches into the defect's outline."""
    reach_um = one.radius_um + ROOM_UM
    if math.hypot(defect.center.x_um - one.x_um, defect.center.y_um - one.y_um) <= reach_um:
        return True
    xa, ya, xb, yb = defect.outline.bounds_um
    if not (xa - reach_um <= one.x_um <= xb + reach_um and ya - reach_um <= one.y_um <= yb + reach_um):
        return False
    around = np.linspace(0, 2 * np.pi, 9)[:-1]
    x_um = one.x_um + reach_um * np.append(0, np.cos(around))
    y_um = one.y_um + reach_um * np.append(0, np.sin(around))
    return bool(defect.outline.contains(x_um, y_um).any())
