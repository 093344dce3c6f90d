"""Results as a table: what a spreadsheet gets to read."""

from __future__ import annotations

import csv
import io

from wafer_viewer.model.findings import MeasurementResults
from wafer_viewer.model.measurement.measurements import AreaVolume, Distance, StepHeight, Texture
from wafer_viewer.model.measurement.tool_options import Levelling
from wafer_viewer.model.quantity import BudgetLine, Contribution, Length, Quantity
from wafer_viewer.model.region import Region
from wafer_viewer.store.tables.csv_tables import findings_csv

SQUARE = Region.rectangle(0, 0, 10, 20)
STEP = {
    "definition": "common plane",
    "upper": SQUARE,
    "lower": Region.rectangle(20, 0, 30, 10),
    **{f"{side}_{what}": 1.0 for side in ("upper", "lower") for what in ("mean_um", "sq_um")},
    "upper_points": 10,
    "lower_points": 12,
}


def table(*findings):
    """The lines of a table by (number of the result, quantity)."""
    rows = csv.DictReader(io.StringIO(findings_csv(MeasurementResults(items=findings))))
    return {(int(row["number"]), row["quantity"]): row for row in rows}


def test_a_number_has_its_uncertainty_or_the_word_why_not():
    height = Length.evaluated(399.8812, (Contribution(name="z scale", u_um=0.1),))
    bare = Length(value_um=1.5, status="uncalibrated")
    found = table(
        StepHeight(number=1, name='block, "A"', height=height, simulated=True, **STEP),
        StepHeight(number=2, height=bare, show=3, levelling=Levelling(by="plane"), **STEP),
    )
    first, second = found[1, "height"], found[2, "height"]
    assert (first["name"], first["kind"], first["simulated"]) == ('block, "A"', "step_height", "SIMULATED")
    assert [first[c] for c in ("value", "U", "unit", "k", "status")] == ["399.881", "0.2", "um", "2", "evaluated"]
    assert (first["x_um"], first["y_um"], first["levelled by"]) == ("5.00", "10.00", "stage")
    assert [second[c] for c in ("U", "k", "status", "levelled by", "show")] == ["", "", "uncalibrated", "plane", "3"]
    assert (found[1, "upper_mean"]["unit"], found[1, "lower_points"]["unit"]) == ("um", "1")
    assert found[1, "relative_tilt"]["unit"] == "mrad"


def test_what_is_no_length_has_its_own_unit():
    slope = Quantity.evaluated(3.25, "deg", (BudgetLine(name="noise", u=0.05),))
    length, point = Length(value_um=7.0), Region.point(1.0, 2.0)
    direction = Distance(number=1, start=point, end=point, distance=length, lateral=length, dz=length, slope=slope)
    um2, um3 = (Quantity(value=v, unit=u) for v, u in ((200.0, "um2"), (1234.5, "um3")))
    none = Quantity(value=0.0, unit="um3")
    over = AreaVolume(
        number=2,
        region=SQUARE,
        reference="border",
        volume_above=none,
        volume_below=um3,
        area=um2,
        area_above=um2,
        area_below=um2,
        highest=length,
        lowest=length,
        noise_um=0.1,
        measured_fraction=0.75,
    )
    found = table(direction, over)
    assert [found[1, "slope"][c] for c in ("value", "U", "unit")] == ["3.25", "0.1", "deg"]
    assert [found[2, "volume_below"][c] for c in ("value", "unit", "status")] == ["1234.5", "um3", "not evaluated"]
    assert [found[2, "measured_fraction"][c] for c in ("value", "unit", "status")] == ["0.75", "1", ""]
    assert next(quantity for number, quantity in found if number == 2) == "volume_below", "what stands for it is first"


def test_what_a_flat_surface_does_not_have_is_left_out():
    zero = Length(value_um=0.0)
    heights = dict.fromkeys(("sa", "sq", "sp", "sv", "sz"), zero)
    flat = Texture(number=1, region=SQUARE, **heights, ssk=None, sku=None, points=400, measured_fraction=1.0)
    assert (1, "sa") in table(flat)
    assert (1, "ssk") not in table(flat)
