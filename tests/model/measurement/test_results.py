"""What all results have in common."""

from __future__ import annotations

import typing

import pytest

from wafer_viewer.model.findings import AnyResult

RESULTS = typing.get_args(AnyResult)


@pytest.mark.parametrize("kind", RESULTS, ids=lambda kind: kind.__name__)
def test_every_result_names_the_fields_with_its_regions(kind):
    assert kind.input_fields
    assert set(kind.input_fields) <= set(kind.__struct_fields__)
    assert "main" in vars(kind)
