"""Class tables of a fab: read from a file, refused with the mend, and used by KLARF and judgements."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.datasets.inspections import defect, inspection, written_klarf
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.inspection.defect import DefectRecipe, Inspection
from wafer_viewer.model.inspection.defect_classes import DEFECT_CLASSES, class_table
from wafer_viewer.model.spec import decode, encode
from wafer_viewer.store.records.inspection_records import read_class_table
from wafer_viewer.store.tables.klarf import read_klarf

TABLE = """
[[classes]]
name = "Fall-on"
code = "P01"
colour = "#CA8515"
key = "1"
klarf_number = 41
kind = "particle"

[[classes]]
name = "Probe mark"
code = "X07"
colour = "#112233"
key = "2"
klarf_number = 57
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    (file := tmp_path / "classes.toml").write_text(TABLE)
    return file


def test_table_is_read_and_stands_for_built_in_classes(path: Path):
    classes = read_class_table(path)
    table = class_table(classes)
    assert [(entry.name, entry.title, entry.key) for entry in table.offered] == [
        ("particle", "Fall-on", "1"),
        ("Probe mark", "Probe mark", "2"),
    ]
    assert (table["particle"].klarf_number, table["Probe mark"].colour) == (41, "#112233")
    assert (table["pit"].title, table["pit"].key, table["pit"].klarf_number) == ("Pit", "", 0)
    assert table["of another table"].title == "of another table"
    assert class_table() is DEFECT_CLASSES
    recipe = DefectRecipe(product="LX-7", classes=classes)
    assert decode(encode(recipe), DefectRecipe, "recipe") == recipe


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('code = "X07"\n', "", "classes.toml: Object missing required field 'code' at"),
        ("klarf_number = 57\n", "", "classes.toml: Object missing required field 'klarf_number' at"),
        ('key = "2"', 'key = "1"', "The classes Fall-on and Probe mark have the same key, 1: change one"),
        ('code = "X07"', 'code = "P01"', "have the same code, P01"),
        ("klarf_number = 57", "klarf_number = 41", "have the same KLARF number, 41"),
        ("klarf_number = 57", 'klarf_number = 57\nkind = "particle"', "have the same built-in class, particle"),
        (
            'name = "Probe mark"',
            'name = "pit"',
            "name is .pit.: it must be another name, or kind 'pit'",
        ),
        ('"#112233"', '"blue"', "colour is .blue.: it must be a colour as #RRGGBB"),
        ('key = "2"', 'key = "22"', "key is .22.: it must be one digit from 1 to 9, or empty"),
        ('key = "2"', 'key = "0"', "key is .0.: it must be one digit from 1 to 9"),
        ("klarf_number = 57", "klarf_number = 0", "klarf_number"),
        ('kind = "particle"', 'kind = "dirt"', "'dirt'"),
    ],
)
def test_a_table_that_cannot_be_used_is_refused(path: Path, old: str, new: str, says: str):
    path.write_text(TABLE.replace(old, new))
    with pytest.raises(MeasureError, match=says):
        read_class_table(path)


def test_klarf_has_the_numbers_names_and_codes_of_the_fab(path: Path, tmp_path: Path):
    found = inspection(
        defect(1, "0,0", 100.0, 50.5),
        defect(2, "1,0", 100.0, 50.5, judged_kind="Probe mark", judgement="real"),
        defect(3, "2,0", 100.0, 50.5, kind="pit"),
        recipe=DefectRecipe(product="LX-7", classes=read_class_table(path)),
    )
    for version in ("1.2", "1.8"):
        klarf = read_klarf(written_klarf(found, tmp_path / f"w{version}.klarf", version=version))
        assert klarf.classes == ((0, "Unclassified"), (41, "Fall-on"), (57, "Probe mark"))
        assert [(d.class_number, d.class_name) for d in klarf.defects] == [
            (41, "Fall-on"),
            (57, "Probe mark"),
            (0, "Unclassified"),
        ]
    assert '57 "Probe mark" "X07" ;' in (tmp_path / "w1.8.klarf").read_text()
    assert decode(encode(found, "json"), Inspection, "defects.json", "json") == found
