"""Inputs that are made of a spec: their kind, label, limit and choices, and what they put."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import pytest

from wafer_viewer.gui.elements.elements import Checkbox, Dropdown, Input, Number, NumberOrEmpty, Slider, Text
from wafer_viewer.gui.elements.form import form
from wafer_viewer.model.errors import PlanError
from wafer_viewer.model.spec import (
    Fraction,
    NonNegative,
    Positive,
    Setting,
    Spec,
    Within,
    settings_of,
    value_at,
    with_field,
)

SHAPE = Setting("Shape", "Of the mark", titles={"dot": "A dot", "bar": "A bar"})


class Mark(Spec, frozen=True, kw_only=True):
    """A mark."""

    name: Annotated[str, Setting("Name", "As on the drawing")] = ""
    shape: Annotated[Literal["dot", "bar"], SHAPE] = "dot"
    width_um: Annotated[Positive, Setting("Width, µm", "Across", decimals=2, step=0.5)] = 3.0
    depth_um: Annotated[NonNegative | None, Setting("Depth, µm", "Into the sample", "not etched")] = None
    filled: Annotated[bool, Setting("Filled", "With metal")] = False
    code: int = 0


class Mask(Spec, frozen=True, kw_only=True):
    """A mask with a mark."""

    mark: Mark = Mark()
    spare: Mark | None = None
    layer: Annotated[int, Within(1, 9), Setting("Layer", "From the bottom")] = 1
    dose: Annotated[Fraction, Setting("Dose", "Of the largest", step=0.1)] = 0.5


ALL = ("mark.name", "mark.shape", "mark.width_um", "mark.depth_um", "mark.filled", "layer", "dose")


def inputs(mask: Mask = Mask(), **state: Any) -> tuple[dict[str, Input], list[tuple[str, Any]]]:
    put: list[tuple[str, Any]] = []
    made = form(mask, lambda path, value: put.append((path, value)), *ALL, **state)
    return dict(zip(ALL, made, strict=True)), put


def test_kind_of_an_input_follows_the_type_of_its_field():
    kinds = [type(one) for one in inputs()[0].values()]
    assert kinds == [Text, Dropdown, Number, NumberOrEmpty, Checkbox, Number, Slider]


def test_label_limit_and_look_are_those_of_the_field():
    width, depth = inputs()[0]["mark.width_um"], inputs()[0]["mark.depth_um"]
    assert isinstance(width, Number)
    assert (width.label, width.hint, width.step, width.decimals) == ("Width, µm", "Across; over 0", 0.5, 2)
    assert (depth.hint, settings_of(Mask)["mark.depth_um"].setting.empty) == (
        "Into the sample; at least 0",
        "not etched",
    )
    assert inputs()[0]["layer"].hint == "From the bottom; between 1 and 9"


def test_choice_shows_titles_and_puts_the_value():
    made, put = inputs(Mask(mark=Mark(shape="bar")))
    shape = made["mark.shape"]
    assert isinstance(shape, Dropdown)
    assert (shape.value, shape.options) == ("A bar", ("A dot", "A bar"))
    shape.put("A dot")
    made["layer"].put(4)
    assert put == [("mark.shape", "dot"), ("layer", 4)]


def test_state_is_that_of_every_input():
    made, _ = inputs(disabled=True, commands=True)
    assert all(one.disabled and one.commands for one in made.values())


def test_fields_without_a_label_and_specs_that_are_left_out_need_no_input():
    assert "mark.code" not in settings_of(Mask)
    assert "spare.name" in settings_of(Mask)


def test_path_leads_to_a_field_whose_new_value_is_checked():
    mask = with_field(Mask(), "mark.width_um", 8.0)
    assert (value_at(mask, "mark.width_um"), mask.mark.name) == (8.0, "")
    with pytest.raises(PlanError, match=r"Mark.width_um is 0: it must be over 0"):
        with_field(mask, "mark.width_um", 0)
