"""Focus curve of a pixel: selects the field of a position; for workers and the command line."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from wafer_viewer.model.acquisition.plan import Field, ScanPlan
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.progress import Progress, ShouldStop, never, silent
from wafer_viewer.model.surface.focus_curve import FocusCurve
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.session.surface.placement_summary import as_stitched

if TYPE_CHECKING:
    from wafer_viewer.store.dataset.dataset import Dataset
    from wafer_viewer.store.dataset.result import Result


def focus_curve(
    dataset: Path,
    result: str,
    field_number: int,
    x_um: float,
    y_um: float,
    recipe: Recipe | None = None,
    *,
    progress: Progress = silent,
    should_stop: ShouldStop = never,
) -> FocusCurve:
    """Return the focus curve at a position of a dataset; field_number 0: of the field with the nearest centre.

    A position on the stitched surface (field_number 0) is located in the field's displayed place, one on a field at its
    stage position. recipe: None means the recipe of the field's surface, or the default if there is none yet. Raises
    DatasetError when no field contains the position or its frames do not exist.
    """
    from wafer_viewer.reconstruct import focus_evidence
    from wafer_viewer.store.dataset.dataset import Dataset

    data = Dataset.open(dataset)
    kept = data.result(result)
    field = data.field(field_number) if field_number else field_at(data, kept, x_um, y_um)
    stack = dataclasses.replace(data.stack(field.number), field=field)
    return focus_evidence.focus_curve(stack, x_um, y_um, recipe or _recipe_of(kept, field))


def field_at(data: Dataset, kept: Result, x_um: float, y_um: float) -> Field:
    """Return the field with the nearest centre of those that contain a position, as displayed in the stitched surface.

    Fields with a surface take precedence. Raises DatasetError if there is none.
    """
    plan = data.scan.plan
    if not data.fields:
        raise DatasetError(f"{data.path.name} is a surface without frames: there is no focus curve to look at.")
    holding = [f for f in as_stitched(data.fields, kept.poses()) if _holds(plan, f, data.scan.pixel_um, x_um, y_um)]
    if not holding:
        raise DatasetError(
            f"({x_um:.1f}, {y_um:.1f}) um lies in no field of {data.path.name}: "
            f"choose a place between {_ends(plan, data.fields, data.scan.pixel_um)} um."
        )
    done = kept.surfaces_done(holding)
    return min(holding, key=lambda f: (f.number not in done, math.hypot(f.x_um - x_um, f.y_um - y_um)))


def _recipe_of(kept: Result, field: Field) -> Recipe:
    return kept.surface(field).provenance.recipe if kept.surfaces_done([field]) else Recipe()


def _holds(plan: ScanPlan, field: Field, pixel_um: float, x_um: float, y_um: float) -> bool:
    return 2 * abs(x_um - field.x_um) < plan.cols * pixel_um and 2 * abs(y_um - field.y_um) < plan.rows * pixel_um


def _ends(plan: ScanPlan, fields: Iterable[Field], pixel_um: float) -> str:
    """Return the lowest and the highest corner of all fields, as text."""
    half_x, half_y = plan.cols * pixel_um / 2, plan.rows * pixel_um / 2
    x, y = [f.x_um for f in fields], [f.y_um for f in fields]
    return f"({min(x) - half_x:.1f}, {min(y) - half_y:.1f}) and ({max(x) + half_x:.1f}, {max(y) + half_y:.1f})"
