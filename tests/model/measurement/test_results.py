"""What all results have in common."""

from __future__ import annotations

import dataclasses
import typing

import pytest

from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.measurement.measurements import MeasurementResult
from wafer_viewer.model.measurement.result_rows import labels_of
from wafer_viewer.model.measurement.tools import TOOLS
from wafer_viewer.model.quantity import Length, Quantity

RESULTS = typing.get_args(AnyResult)


@pytest.mark.parametrize("kind", RESULTS, ids=lambda kind: kind.__name__)
def test_every_result_names_the_fields_with_its_regions(kind):
    assert kind.input_fields
    assert set(kind.input_fields) <= set(kind.__struct_fields__)


@pytest.mark.parametrize("kind", RESULTS, ids=lambda kind: kind.__name__)
def test_the_main_quantity_of_every_result_is_one_of_its_fields(kind):
    hints = typing.get_type_hints(kind)
    assert {hints[name] for name in kind.main_fields} <= {Length, Quantity}


@pytest.mark.parametrize("kind", RESULTS, ids=lambda kind: kind.__name__)
def test_every_field_of_a_result_has_a_title_of_its_own(kind):
    titles = [label.title for label in labels_of(kind).values() if label.listed]
    assert all(titles)
    assert len(set(titles)) == len(titles)


def test_a_tool_is_refused_whose_result_names_no_main_quantity():
    class Unnamed(MeasurementResult, frozen=True, kw_only=True, tag="unnamed"):
        pass

    with pytest.raises(TypeError, match="Unnamed must name the field with its main quantity in main_fields"):
        dataclasses.replace(TOOLS["step"], result=Unnamed)
