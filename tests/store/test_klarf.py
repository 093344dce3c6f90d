"""KLARF 1.2: what is written is read back, and what is damaged or in another unit is refused in one sentence."""

from __future__ import annotations

import re
from collections.abc import Callable
from datetime import datetime
from pathlib import Path

import pytest

from tests.store.inspections import GRID, defect, inspection
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.klarf import CLASS_NUMBERS
from wafer_viewer.model.sample import Sample
from wafer_viewer.store.klarf import write_klarf
from wafer_viewer.store.klarf_reading import read_klarf

SAMPLE = Sample(lot="L-204", wafer_id="W07", product="LX-7", slot=7, notch="left", width_um=100_000.0)
FOUND = inspection(
    defect(1, "0,0", 100.0, 50.5),
    defect(2, "2,1", 7.25, 701.0, kind="pit", judged_kind="residue", judgement="real"),
    defect(5, "2,1", -12.0, 30.0, kind="scratch", judgement="nuisance"),
    defect(6, "1,0", 400.0, 300.0, kind="unmeasured"),
    states={"1,1": "not scanned", "0,1": "partly scanned"},
)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return write_klarf(FOUND, tmp_path / "w07.klarf", SAMPLE, at=datetime(2026, 11, 22, 5, 1, 2))


def test_what_is_written_is_read_back(file: Path):
    klarf = read_klarf(file)
    assert (klarf.lot, klarf.wafer, klarf.slot, klarf.device) == ("L-204", "W07", 7, "LX-7")
    assert (klarf.version, klarf.notch, klarf.sample_mm, klarf.setup) == ("1.2", "LEFT", 100.0, "standard")
    assert (klarf.pitch_x_um, klarf.pitch_y_um) == (GRID.pitch_x_um, GRID.pitch_y_um)
    assert (klarf.center_x_um, klarf.center_y_um) == (1000.0, 800.0)
    first, second, third = klarf.defects
    assert (first.number, first.col, first.row, first.u_um, first.v_um) == (1, 0, 0, 100.0, 50.5)
    assert (first.width_um, first.height_um, first.area_um2, first.size_um) == (12.0, 10.0, 94.0, 12.0)
    assert [(d.class_name, d.bin) for d in (first, second, third)] == [("Particle", 0), ("Residue", 1), ("Scratch", 2)]
    assert klarf.inspected_um2 == pytest.approx(4.3e6)


def test_a_die_of_which_nothing_is_known_does_not_look_clean(file: Path):
    dies = read_klarf(file).dies
    assert (0, 0) in dies
    assert (2, 0) in dies, "a whole die without defects was inspected"
    assert (1, 1) not in dies, "it was not scanned"
    assert (0, 1) not in dies, "it was only partly scanned"


def test_its_defects_lie_over_the_surface_they_were_found_on(file: Path):
    klarf = read_klarf(file)
    for outline, found in zip(klarf.outlines(), FOUND.found, strict=True):
        assert outline.points[0].x_um == pytest.approx(found.center.x_um, abs=0.01)
        assert outline.points[0].y_um == pytest.approx(found.center.y_um, abs=0.01)
    assert klarf.matched(FOUND.found[1:], within_um=5.0) == {2: 2, 5: 5}


def test_a_clean_wafer_has_an_empty_list_and_says_where_was_looked(tmp_path: Path):
    klarf = read_klarf(write_klarf(inspection(), tmp_path / "clean.klarf", SAMPLE))
    assert klarf.defects == ()
    assert len(klarf.dies) == 6


def test_every_class_but_unmeasured_has_a_number():
    assert sorted(CLASS_NUMBERS.values()) == list(range(1, 9))


def test_without_dies_it_says_so(tmp_path: Path):
    with pytest.raises(DatasetError, match="gives places by dies and this inspection has none"):
        write_klarf(inspection(grid=None), tmp_path / "no.klarf")
    assert not list(tmp_path.iterdir())


def test_nanometres_are_converted_where_the_file_says_so(file: Path, tmp_path: Path):
    in_nm = tmp_path / "nm.klarf"
    text = file.read_text().replace("DiePitch 1000.000000 800.000000", "DiePitch 1000000 800000")
    text = text.replace(" 1 100.000 50.500 0 0 12.000", " 1 100000 50500 0 0 12000")
    in_nm.write_text(text.replace("FileVersion 1 2;", "FileVersion 1 2;\nUnits nm;"))
    klarf = read_klarf(in_nm)
    assert (klarf.pitch_x_um, klarf.defects[0].u_um, klarf.defects[0].width_um) == (1000.0, 100.0, 12.0)
    assert klarf.notes == ("Lengths were converted from nm to um.",)


def _replaced(old: str, new: str) -> Callable[[str], str]:
    return lambda text: text.replace(old, new)


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (lambda text: text[: len(text) // 2], "is cut off, it has no EndOfFile"),
        (lambda text: text[1:], "is no KLARF file"),
        (_replaced("\n 1 100.000", "\n;\n 1 100.000"), "its summary counts 3 defects and 0 are listed"),
        (lambda text: re.sub(r"\n 2 7\.250.*", "", text), "its summary counts 3 defects and 2 are listed"),
        (_replaced(" 5 -12.000", " 5\n -12.000"), "line 3 of its defects has 1 of 16 numbers"),
        (_replaced("DiePitch 1000.000000 800.000000", "DiePitch 1000000 800000"), "it is in another unit"),
        (_replaced("DiePitch 1000.000000 800.000000", "DiePitch 1.0 0.8"), "it is in another unit, say which"),
        (_replaced(" 1 100.000 50.500", " 1 100000 50500"), "its places are in another unit than its dies"),
        (_replaced("FileVersion 1 2;", "FileVersion 1 2;\nUnits inch;"), "its unit is 'inch', not one of um, nm, mm"),
        (_replaced("FileVersion 1 2", "FileVersion 1 8"), "it is KLARF 1.8 and not one of 1.0, 1.1, 1.2"),
        (_replaced("XREL", "XABS"), "its defects have no XREL"),
        (_replaced("SampleTestPlan 4", "SampleTestPlan 9"), "its test plan names 4 of 9 dies"),
        (_replaced("100.000 50.500", "100.000 5o.500"), "has a damaged record"),
        (_replaced("Slot 7;", 'Slot 7;\nWaferID "W08";'), "holds several wafers"),
        (_replaced("DiePitch", "DiePatch"), "it has no record DiePitch"),
    ],
)
def test_what_is_wrong_is_said_in_one_sentence(file: Path, damage: Callable[[str], str], says: str):
    damaged = damage(file.read_text())
    assert damaged != file.read_text()
    file.write_text(damaged)
    with pytest.raises(DatasetError, match=says) as fault:
        read_klarf(file)
    assert str(fault.value).count(". ") == 0


def test_without_a_summary_it_is_said_that_nothing_was_counted(file: Path):
    file.write_text(file.read_text().replace("SummaryList", "SummaryLost"))
    assert read_klarf(file).notes == ("The file has no summary: whether records are missing cannot be told.",)


def test_lines_that_list_images_are_no_defects(file: Path):
    file.write_text(file.read_text().replace("6.000 0 0\n 2", "6.000 1\n 1 0\n 2"))
    assert [d.number for d in read_klarf(file).defects] == [1, 2, 5]


def test_a_file_that_is_not_there_is_told(tmp_path: Path):
    with pytest.raises(DatasetError, match="does not exist"):
        read_klarf(tmp_path / "gone.klarf")
