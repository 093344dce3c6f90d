"""Areas of every die that are left out of the search."""

from __future__ import annotations

import numpy as np
import pytest

from tests.measure.defects.test_inspection import BUMP, DULL, PLANTED, at, inspected, made
from tests.support.noisy_wafer import PIXEL_UM
from wafer_viewer.measure.defects.inspection import exclusion_mask, inspect
from wafer_viewer.measure.dies.die_cells import CellGrid
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.inspection.defect import Defect, DefectRecipe
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace


def around(defect: Defect, spare_um: float) -> Region:
    """A square round a defect, from the corner of its die."""
    half_um = defect.major.value_um / 2 + spare_um
    assert defect.in_die is not None
    u_um, v_um = defect.in_die.x_um, defect.in_die.y_um
    return Region.rectangle(u_um - half_um, v_um - half_um, u_um + half_um, v_um + half_um)


@pytest.mark.slow
def test_what_lies_in_an_excluded_area_is_not_found_the_rest_is_and_the_area_is_reported() -> None:
    before = inspected(made())
    area = around(at(before, BUMP), 6 * PIXEL_UM)
    after = inspected(made(), replace(DULL, excluded=(area,)))
    assert len(after.found) == len(PLANTED) - 1
    assert not any(area.contains(d.in_die.x_um, d.in_die.y_um) for d in after.found if d.in_die is not None)
    assert before.inspected_mm2 - after.inspected_mm2 == pytest.approx(9 * area.area_um2 / 1e6, rel=0.1)
    assert after.unmeasured_mm2 <= before.unmeasured_mm2
    (note,) = (note for note in after.notes if "Left out" in note)
    assert note.startswith("Left out of every die, as the recipe asks: 1 area, ")


@pytest.mark.slow
def test_heights_next_to_an_excluded_area_are_as_sure_as_elsewhere() -> None:
    before = at(inspected(made()), BUMP)
    _, y0, x1, y1 = around(before, 2 * PIXEL_UM).bounds_um
    neighbour = Region.rectangle(x1, y0, x1 + 20 * PIXEL_UM, y1)
    after = at(inspected(made(), replace(DULL, excluded=(neighbour,))), BUMP)
    assert after.score == pytest.approx(before.score, rel=0.1)
    assert after.height.value_um == pytest.approx(before.height.value_um, rel=0.02)


def test_the_pixels_of_a_cell_that_are_left_out_are_those_inside() -> None:
    cells = CellGrid.of(made().grid, PIXEL_UM)
    regions = (Region.circle(20.0, 14.0, 6.0), Region.polygon((40.0, 10.0), (55.0, 12.0), (47.0, 30.0)))
    rows, cols = np.indices(cells.shape).astype(float)
    inside = np.logical_or(*(region.contains(*cells.in_die(rows, cols)) for region in regions))
    excluded = exclusion_mask(regions, cells)
    assert excluded is not None
    assert inside.sum() > 500
    assert (excluded == inside).all()
    assert exclusion_mask((Region.circle(-500.0, 14.0, 6.0),), cells) is None


@pytest.mark.slow
def test_without_dies_nothing_is_left_out_and_that_is_reported() -> None:
    inspection = inspect(made().surface, recipe=replace(DULL, excluded=(Region.circle(20.0, 14.0, 6.0),)))
    assert any(note.startswith("No area was left out") for note in inspection.notes)


def test_what_has_no_area_leaves_nothing_out() -> None:
    with pytest.raises(MeasureError, match=r"excluded .*rectangles, circles or polygons"):
        DefectRecipe(excluded=(Region.line(0.0, 0.0, 5.0, 5.0),))
