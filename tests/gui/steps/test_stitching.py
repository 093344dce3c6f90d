"""What the page says of how fields were placed."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from tests.support.made_up_poses import made_up_poses, stitching_of
from tests.support.page_stand_in import COLS, PIXEL_UM, ROWS, grid
from wafer_viewer.gui.shell.header import by_stage
from wafer_viewer.gui.steps.surface import reconstruction as words
from wafer_viewer.model.surface.field_poses import RejectionReason

FIELDS = grid(3, 3).fields(0.0)
SIZE_UM = (COLS * PIXEL_UM, ROWS * PIXEL_UM)
POSES = made_up_poses(
    FIELDS,
    *SIZE_UM,
    {(4, 5): RejectionReason.BLANK, (5, 8): RejectionReason.AMBIGUOUS, (1, 2): RejectionReason.DISAGREES},
)
FOUND = dataclasses.replace(stitching_of(POSES), step_median_um=0.0083, step_p95_um=0.0521, moved_max_um=7.94)


def text(html: str) -> str:
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", html)).replace("\u202f", " ")


def rows_of(html: str) -> list[list[str]]:
    lines = re.findall(r"<tr[^>]*>(.*?)</tr>", html)
    return [
        [text(cell).strip() for cell in re.findall(r"<td[^>]*>(.*?)</td>", line)] for line in lines if "<td" in line
    ]


def test_numbers_have_units_signs_and_two_figures():
    said = text(words.stitching_numbers(FOUND))
    for phrase in ("9 of 12", "it fits at several places 1", "0.0083 µm", "0.052 µm", "± 0.062 µm"):
        assert phrase in said


def test_steps_that_are_not_known_are_not_told():
    said = text(words.stitching_numbers(dataclasses.replace(FOUND, step_median_um=None, step_p95_um=None)))
    assert "Step" not in said


def test_the_form_that_the_stage_alone_knows_stands_in_the_details():
    said = text(words.details(FOUND))
    assert "Known only from the stage" in said
    assert "Bow ± 0.82 µm" in said
    assert "largest 7.9 µm" in said
    assert "nan" not in text(words.details(dataclasses.replace(FOUND, form=(("bow", float("inf")),))))


def test_doubted_overlaps_are_named_the_farthest_off_first_and_blank_ones_last():
    rows = rows_of(words.rejected_overlaps(POSES, 0.5))
    assert {row[0] for row in rows[:2]} == {"5 – 8", "1 – 2"}
    assert rows[2] == ["4 – 5", "nothing to compare", "–", "–"]
    off = [float(row[2]) for row in rows[:2]]
    assert off == sorted(off, reverse=True)
    assert np.allclose([float(row[3]) for row in rows[:2]], 2 * np.array(off), atol=0.07)


def test_many_doubted_overlaps_unfold_and_the_rest_is_counted():
    fields = grid(10, 10).fields(0.0)
    poses = made_up_poses(fields, *SIZE_UM)
    shifts = poses.shifts
    doubt = np.full(len(shifts.doubt), RejectionReason.UNLIKE, np.uint8)
    all_doubted = dataclasses.replace(poses, shifts=dataclasses.replace(shifts, doubt=doubt))
    said = words.rejected_overlaps(all_doubted, 0.5)
    assert len(rows_of(said)) == words.LISTED
    assert f"{180 - words.SHOWN} more" in text(said)
    assert f"and {180 - words.LISTED} with smaller offsets" in text(said)
    assert words.rejected_overlaps(dataclasses.replace(poses, shifts=shifts), 0.5) == ""


def test_what_a_person_should_look_at_is_said_in_sentences():
    asks = dataclasses.replace(FOUND, left_out=(7,), n_groups=3, notes=("Field 2 moved by 4 um <b>",))
    said = words.cautions(asks)
    assert (
        text(words.cautions(dataclasses.replace(asks, notes=("Field 7 fits if it is turned",)))).count("Field 7") == 1
    )
    assert "attention" in said
    assert "<b>" not in said
    for phrase in ("Field 7 is left out: it matches none", "3 islands", "Field 2 moved by 4 µm"):
        assert phrase in text(said)
    assert words.cautions(FOUND) == ""
    several = text(words.cautions(dataclasses.replace(FOUND, left_out=tuple(range(1, 12)))))
    assert "Fields 1, 2, 3, 4, 5, 6, 7, 8 and 3 more are left out" in several


def test_fields_that_hang_on_the_stage_alone_are_counted_in_the_status_line():
    note = "Stitched by the stage's positions alone: 24 of 24 overlaps ambiguous (repeating pattern)."
    alone = dataclasses.replace(FOUND, n_believed=0, n_groups=16, n_by_stage=16, notes=(note,))
    assert by_stage(alone, 16) == ("Stitched by the stage alone", note)
    said = text(words.cautions(alone))
    assert "24 of 24 overlaps ambiguous (repeating pattern)" in said
    assert "islands" not in said
    assert by_stage(dataclasses.replace(FOUND, n_by_stage=3), 16)[0] == "3 of 16 fields by the stage alone"
    assert by_stage(FOUND, 16) == ("", "")


@pytest.mark.parametrize(
    ("probability", "said"),
    [
        (0.99999, "practically sure, over 99.9 %"),
        (0.9964, "sure, 99.6 %"),
        (0.9, "likely, 90 %"),
        (0.5, "open, 50 %"),
    ],
)
def test_how_sure_a_period_is_stands_in_words_and_as_a_number(probability: float, said: str):
    assert said in text(words.how_sure(probability))
    periodic = dataclasses.replace(FOUND, n_periodic=7, period_probability=probability)
    assert f"least sure of these {said.partition(', ')[2]}" in text(words.stitching_numbers(periodic))


def test_an_open_pattern_says_how_likely_its_best_period_is():
    shifts = POSES.shifts
    candidates = np.zeros((len(shifts.first), 2, 6), np.float32)
    odds = np.full(len(POSES.numbers), 1.5)
    open_ = dataclasses.replace(POSES, shifts=dataclasses.replace(shifts, candidates=candidates), period_odds_nats=odds)
    rows = rows_of(words.rejected_overlaps(open_, 0.5))
    (row,) = [row for row in rows if row[0] == "5 – 8"]
    assert row[1] == "it fits at several places; the likeliest is likely, 81.8 %"
