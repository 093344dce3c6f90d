"""Settings as people meet them: made in Python, read from TOML and JSON, refused with a sentence."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wafer_viewer.model.acquisition.plan import FieldGrid, FocusSweep
from wafer_viewer.model.acquisition.sample import Sample
from wafer_viewer.model.errors import ComputeError, MeasureError, PlanError
from wafer_viewer.model.findings import MeasurementResults
from wafer_viewer.model.job import Job
from wafer_viewer.model.measurement.feature import Feature
from wafer_viewer.model.measurement.measurements import Length, Profile
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import decode, encode, replace
from wafer_viewer.model.surface.recipe import Levy, Recipe

GRID = FieldGrid(rows=3, cols=4, field_width_um=336.0, field_height_um=252.0)
JOB = Job(grid=GRID, sweep=FocusSweep(z_step_um=1.0, n_frames=60), sample=Sample(lot="L7", wafer_id="03"))


@pytest.mark.parametrize("form", ["toml", "json"])
@pytest.mark.parametrize(
    "spec",
    [
        GRID,
        JOB,
        Recipe(levy=Levy(mode="guided", iterations=12)),
        Feature(name="bump", nominal=12.0, lower_limit=11.0, upper_limit=13.0),
    ],
    ids=lambda s: type(s).__name__,
)
def test_a_spec_round_trips_through_its_file(spec, form):
    assert decode(encode(spec, form), type(spec), "file", form) == spec


@given(st.integers(1, 200), st.integers(1, 200), st.floats(0, 0.5), st.floats(1, 1e4))
def test_any_grid_survives_the_round_trip(rows, cols, overlap, width):
    grid = FieldGrid(rows=rows, cols=cols, field_width_um=width, field_height_um=width, overlap_x_fraction=overlap)
    assert decode(encode(grid), FieldGrid, "grid.toml") == grid


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: replace(GRID, overlap_x_fraction=0.6), ["FieldGrid.overlap_x_fraction", "0.6", "between 0 and 0.5"]),
        (lambda: replace(GRID, rows=0), ["FieldGrid.rows", "0", "at least 1"]),
        (lambda: FocusSweep(z_step_um=0.0, n_frames=60), ["FocusSweep.z_step_um", "0.0", "over 0"]),
        (lambda: FocusSweep(z_step_um=1.0, n_frames=2), ["FocusSweep.n_frames", "2", "between 3"]),
        (lambda: replace(GRID, rows=2.5), ["FieldGrid.rows", "2.5", "a whole number"]),
        (lambda: replace(GRID, x0_um=float("nan")), ["FieldGrid.x0_um", "nan", "finite"]),
        (lambda: Job(sweep=JOB.sweep), ["Job.grid", "None", "a list of fields"]),
        (lambda: replace(JOB, released=True), ["Job.released", "'auto'"]),
        (lambda: replace(JOB, exposures_us=()), ["Job.exposures_us", "at least one"]),
        (lambda: Sample(slot=120), ["Sample.slot", "120", "between 0 and 99"]),
    ],
)
def test_what_cannot_be_is_refused_with_field_value_and_limit(make, words):
    with pytest.raises(PlanError) as caught:
        make()
    assert all(word in str(caught.value) for word in words), str(caught.value)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Recipe(window=8), ["Recipe.window", "8", "odd", "'auto'"]),
        (lambda: Recipe(window=27), ["Recipe.window", "27", "between 3 and 25"]),
        (lambda: Recipe(focus_measure="sharpness"), ["Recipe.focus_measure", "'sharpness'", "'tenengrad'"]),
        (lambda: Levy(beta=2.5), ["Levy.beta", "2.5", "between 0 and 2"]),
    ],
)
def test_a_recipe_that_cannot_be_says_so(make, words):
    with pytest.raises(ComputeError) as caught:
        make()
    assert all(word in str(caught.value) for word in words), str(caught.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "rows = 3\ncols = 3\nfield_width_um = 1\nfield_height_um = 1\noverlp = 1",
            ["grid.toml", "unknown key", "overlp"],
        ),
        ("rows = 3", ["grid.toml", "missing", "cols"]),
        ("rows = [", ["grid.toml"]),
        ("rows = 3\ncols = 3\nfield_width_um = 'wide'\nfield_height_um = 1", ["grid.toml", "field_width_um"]),
        (
            "rows = 3\ncols = 3\nfield_width_um = -5\nfield_height_um = 1",
            ["grid.toml", "field_width_um is -5", "over 0"],
        ),
    ],
)
def test_a_bad_file_is_named_with_what_is_wrong_in_it(text, words):
    with pytest.raises(PlanError) as caught:
        decode(text, FieldGrid, "grid.toml")
    assert all(word in str(caught.value) for word in words), str(caught.value)


def test_findings_of_several_kinds_share_one_file():
    line = Region.line(0, 0, 10, 0)
    profile = Profile(
        line=line, length_um=10.0, pt=Length(value_um=1.0), rise=Length(value_um=0.5), measured_fraction=1.0
    )
    findings = MeasurementResults(items=(profile,))
    assert decode(encode(findings, "json"), MeasurementResults, "findings.json", "json") == findings


def test_the_largest_uncertainty_is_doubled_once():
    from wafer_viewer.model.quantity import Contribution

    length = Length.evaluated(400.0, (Contribution(name="noise", u_um=0.3), Contribution(name="z scale", u_um=0.4)))
    assert length.expanded_um == pytest.approx(1.0)


def test_a_sample_of_an_older_file_has_no_size_where_it_says_zero():
    of_none = decode("width_um = 0.0\nheight_um = 0.0\n", Sample, "sample.toml")
    assert (of_none.width_um, of_none.height_um, of_none.size_um) == (None, None, None)
    assert of_none == Sample()
    given = Sample(width_um=12500, height_um=8000)
    assert given.size_um == (12500, 8000)
    assert decode(encode(given), Sample, "newer.toml") == given


def test_a_wrong_word_in_a_file_is_named_with_those_that_may_stand_there():
    with pytest.raises(ComputeError, match=r"'soup' at '.levy.mode': it must be one of 'none', 'literal', "):
        decode('[levy]\nmode = "soup"', Recipe, "recipe.toml")
    with pytest.raises(MeasureError, match=r"'soup' at '.items.0..levelling.by': it must be one of 'stage', "):
        decode('{"items": [{"type": "flatness", "levelling": {"by": "soup"}}]}', MeasurementResults, "f.json", "json")
