"""A job: prepared once by an engineer and run by operators."""

from __future__ import annotations

from typing import Annotated

import msgspec

from wafer_viewer.model.acquisition.alignment import Alignment, Marks
from wafer_viewer.model.acquisition.plan import Field, FieldGrid, FocusSweep
from wafer_viewer.model.acquisition.sample import Sample
from wafer_viewer.model.measurement.feature import Dies, Feature
from wafer_viewer.model.spec import Positive, Spec, Within
from wafer_viewer.model.surface.recipe import Recipe


class Job(Spec, frozen=True, kw_only=True):
    """Complete definition of a job: the file ``PLAN.toml``.

    Either `grid` or `fields` gives the positions, in wafer um if `marks` are given for alignment, else in stage um;
    `strategy` is a strategy of the planner or ``auto``. `alignment` applies to the wafer now on the stage. Features
    measured per die are repeated on `dies`.
    """

    product: str = ""
    revision: str = ""
    sample: Sample = Sample()
    grid: FieldGrid | None = None
    fields: tuple[Field, ...] = ()
    z_start_um: float = 0.0
    sweep: FocusSweep
    exposures_us: tuple[Positive, ...] = (100.0,)
    light_fraction: Annotated[float, Within(0, 1)] = 1.0
    strategy: str = "auto"
    recipe: Recipe = Recipe()
    marks: Marks | None = None
    alignment: Alignment | None = None
    features: tuple[Feature, ...] = ()
    dies: Dies | None = None
    defect_sensitivity: Positive = 5.0
    released: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.grid is None) == (not self.fields):
            self.refuse("grid", "given, or else a list of fields, not both")
        if not self.exposures_us:
            self.refuse("exposures_us", "at least one exposure time")
        if self.released and self.recipe.has_auto:
            self.refuse("released", "false as long as the recipe holds an 'auto'")
        if self.released and self.strategy == "auto":
            self.refuse("released", "false as long as the strategy is 'auto'")
        if self.dies is None and any(feature.per_die for feature in self.features):
            self.refuse("dies", "given where a feature is measured per die")
        if self.alignment is not None and self.marks is None:
            self.refuse("alignment", "left out where there are no marks to align by")

    def all_fields(self) -> tuple[Field, ...]:
        """Return the fields from the grid or as listed, in stage coordinates of the aligned wafer."""
        fields = self.fields if self.grid is None else self.grid.fields(self.z_start_um)
        return fields if self.alignment is None else tuple(_on_stage(field, self.alignment) for field in fields)


def _on_stage(field: Field, alignment: Alignment) -> Field:
    x_um, y_um = alignment.to_stage(field.x_um, field.y_um)
    return msgspec.structs.replace(field, x_um=x_um, y_um=y_um)
