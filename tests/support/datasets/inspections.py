"""Inspections for tests: a few dies with a few defects on them, as if found."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from wafer_viewer.model.acquisition.sample import Sample
from wafer_viewer.model.inspection.defect import Defect, DefectRecipe, Inspection
from wafer_viewer.model.inspection.die_grid import DieGrid, DieMeasurement, DieStatus
from wafer_viewer.model.inspection.klarf import KlarfExport
from wafer_viewer.model.quantity import Length, Quantity
from wafer_viewer.model.region import Point, Region
from wafer_viewer.store.tables.klarf_writer import write_klarf

GRID = DieGrid(
    pitch_x_um=1000.0, pitch_y_um=800.0, width_um=950.0, height_um=760.0, x0_um=-1000.0, y0_um=-800.0, cols=3, rows=2
)


def defect(number: int, die: str, u_um: float, v_um: float, **changes: Any) -> Defect:
    """A round particle of 12 um at a place of a die."""
    col, row = (int(part) for part in die.split(","))
    x, y = (float(um) for um in GRID.to_stage(col, row, u_um, v_um))
    values: dict[str, Any] = {
        "number": number,
        "name": f"Defect {number}",
        "center": Point(x_um=x, y_um=y),
        "die": die,
        "in_die": Point(x_um=u_um, y_um=v_um),
        "outline": Region.rectangle(x - 6, y - 5, x + 6, y + 5),
        "kind": "particle",
        "reasons": ("6 um high", "1.2 times as long as wide"),
        "major": Length(value_um=12.0, expanded_um=0.9, status="evaluated"),
        "minor": Length(value_um=10.0, expanded_um=0.9, status="evaluated"),
        "height": Length(value_um=6.0, expanded_um=0.4, status="evaluated"),
        "area": Quantity(value=94.0, unit="um2"),
        "volume": Quantity(value=300.0, unit="um3"),
        "score": 11.5,
        "confidence": 0.9,
    }
    return Defect(**(values | changes))


def lying(tilt_mrad: float = 0.0, bow_um: float = 0.0) -> DieMeasurement:
    """A die that is tilted along x and bowed."""
    return DieMeasurement(
        tilt_x=Quantity(value=tilt_mrad, unit="mrad", expanded=0.2, status="evaluated"),
        tilt_y=Quantity(value=0.0, unit="mrad", expanded=0.2, status="evaluated"),
        offset=Length(value_um=0.05, expanded_um=0.04, status="evaluated"),
        bow=Length(value_um=bow_um, expanded_um=0.04, status="evaluated"),
        brightness_fraction=0.031,
        u_brightness_fraction=0.002,
    )


def inspection(
    *defects: Defect,
    states: dict[str, str] | None = None,
    measured: dict[str, DieMeasurement] | None = None,
    **changes: Any,
) -> Inspection:
    """Six dies, all scanned but those that `states` says otherwise of."""
    reported = states or {}
    on = [d.die for d in defects if d.kind != "unmeasured"]
    dies = tuple(
        DieStatus(
            name=GRID.name(col, row),
            col=col,
            row=row,
            state=reported.get(GRID.name(col, row), "whole"),  # pyright: ignore[reportArgumentType]
            measured_fraction=0.98,
            defects=None if reported.get(GRID.name(col, row)) == "not scanned" else on.count(GRID.name(col, row)),
            measured=(measured or {}).get(GRID.name(col, row)),
        )
        for col, row in GRID.places
    )
    values: dict[str, Any] = {
        "recipe": DefectRecipe(product="LX-7"),
        "product": "LX-7",
        "reference": "dies",
        "grid": GRID,
        "dies": dies,
        "defects": defects,
        "inspected_mm2": 4.3,
        "expected_false_per_mm2": 0.08,
        "simulated": True,
    }
    return Inspection(**(values | changes))


def written_klarf(
    found: Inspection,
    path: Path,
    sample: Sample = Sample(notch="down", width_um=300_000.0),
    *,
    center_um: tuple[float, float] = (0.0, 0.0),
    images: bool = False,
    **options: Any,
) -> Path:
    """A KLARF of a wafer whose centre is known, by default at the stage's zero."""
    return write_klarf(
        found,
        path,
        sample,
        KlarfExport(center_x_um=center_um[0], center_y_um=center_um[1], step="METAL2", images=images),
        **options,
    )
