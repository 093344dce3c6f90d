"""The uncertainty of a calibration in the budgets of heights and lengths."""

from __future__ import annotations

import dataclasses

import pytest

from tests.support.surfaces import gauge_blocks
from wafer_viewer.measure.tools.step_height import step_height
from wafer_viewer.model.acquisition.characteristics import CalibrationResult
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace

UPPER, LOWER = Region.rectangle(-150, -50, -40, 50), Region.rectangle(40, -50, 150, 50)


def step_with(**values):
    """A step measured after a calibration that set these values."""
    surface = gauge_blocks(1)
    before = surface.provenance.calibration
    result = CalibrationResult(kind="flatness", characteristics=(), sets=values)
    after = result.applied_to(before, before.made, before.due)
    return step_height(
        dataclasses.replace(surface, provenance=replace(surface.provenance, calibration=after)), UPPER, LOWER
    )


def budget_of(step):
    return {line.name: line.u_um for line in step.height.budget}


@pytest.mark.parametrize(
    ("field", "line"),
    [("u_flatness_um", "flatness deviation"), ("u_z_linearity_um", "z linearity")],
)
def test_u_of_a_step_grows_with_that_of_the_calibration_and_names_it(field, line):
    small, large = step_with(**{field: 0.1}), step_with(**{field: 0.5})
    assert (budget_of(small)[line], budget_of(large)[line]) == (0.1, 0.5)
    grown = large.height.u**2 - small.height.u**2
    assert grown == pytest.approx(0.5**2 - 0.1**2, rel=1e-6)


def test_a_calibration_without_flatness_leaves_the_budget_as_it_was():
    step = step_with()
    assert "flatness deviation" not in {*budget_of(step), *step.not_evaluated}
