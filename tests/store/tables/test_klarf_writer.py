"""KLARF 1.2 and 1.8: what is written is read back, and what is damaged or in another unit is refused."""

from __future__ import annotations

import random
import re
from collections.abc import Callable
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
import tifffile

from tests.support.datasets.inspections import GRID, defect, inspection, written_klarf
from tests.support.datasets.samples import make_surface
from tests.support.random_klarf import random_klarf
from wafer_viewer.model.acquisition.sample import Sample
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.inspection.defect import crop
from wafer_viewer.model.inspection.defect_classes import DEFECT_CLASSES
from wafer_viewer.model.inspection.klarf import Klarf, KlarfExport, KlarfImage
from wafer_viewer.model.spec import replace
from wafer_viewer.store.tables.klarf import read_klarf
from wafer_viewer.store.tables.klarf_writer import KlarfVersion, write_klarf

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
    return written_klarf(FOUND, tmp_path / "w07.klarf", SAMPLE, at=datetime(2026, 11, 22, 5, 1, 2))


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


def test_simulation_is_read_back(file: Path, tmp_path: Path):
    assert read_klarf(file).simulated
    assert not read_klarf(written_klarf(inspection(simulated=False), tmp_path / "real.klarf")).simulated


def test_its_defects_lie_over_the_surface_they_were_found_on(file: Path):
    klarf = read_klarf(file)
    for outline, found in zip(klarf.outlines(), FOUND.found, strict=True):
        assert outline.points[0].x_um == pytest.approx(found.center.x_um, abs=0.01)
        assert outline.points[0].y_um == pytest.approx(found.center.y_um, abs=0.01)
    assert klarf.matched(FOUND.found[1:], within_um=5.0) == {2: 2, 5: 5}


def test_a_clean_wafer_has_an_empty_list_and_says_where_was_looked(tmp_path: Path):
    klarf = read_klarf(written_klarf(inspection(), tmp_path / "clean.klarf", SAMPLE))
    assert klarf.defects == ()
    assert len(klarf.dies) == 6


def test_every_class_but_unmeasured_has_a_number():
    assert sorted(DEFECT_CLASSES.numbers) == list(range(1, 13))


def test_missing_dies_are_reported(tmp_path: Path):
    with pytest.raises(DatasetError, match="gives places by dies and this inspection has none"):
        written_klarf(inspection(grid=None), tmp_path / "no.klarf")
    assert not list(tmp_path.iterdir())


def test_nothing_that_is_not_known_is_written(tmp_path: Path):
    lacks = r"the wafer's centre .*--center-um\), the side of the notch \(--notch\), .*--diameter-mm\), .*\(--step\)"
    with pytest.raises(DatasetError, match=lacks):
        write_klarf(FOUND, tmp_path / "w.klarf")
    stated = KlarfExport(center_x_um=5.0, center_y_um=0.0, notch="left", diameter_mm=76.2, step="BUMP")
    for name in ("center_x_um", "notch", "diameter_mm", "step"):
        with pytest.raises(DatasetError, match="A KLARF states"):
            write_klarf(FOUND, tmp_path / "w.klarf", stated=replace(stated, **{name: getattr(KlarfExport(), name)}))
    assert not list(tmp_path.iterdir())
    klarf = read_klarf(write_klarf(FOUND, tmp_path / "w.klarf", SAMPLE, stated))
    assert (klarf.notch, klarf.sample_mm, klarf.step, klarf.center_x_um) == ("LEFT", 76.2, "BUMP", 1005.0)


@pytest.mark.parametrize("version", ["1.2", "1.8"])
def test_an_image_of_each_defect_is_written_and_read(tmp_path: Path, version: KlarfVersion):
    surface = make_surface(rows=1800, cols=3300, pixel_um=1.0, x0_um=-1200.0, y0_um=900.0)
    path = written_klarf(FOUND, tmp_path / "w07.klarf", SAMPLE, surface=surface, images=True, version=version)
    klarf = read_klarf(path)
    assert [d.images for d in klarf.defects] == [(KlarfImage(file="w07.tif", page=page),) for page in (1, 2, 3)]
    with tifffile.TiffFile(tmp_path / "w07.tif") as file:
        for page, found in zip(file.pages, FOUND.found, strict=True):
            np.testing.assert_array_equal(page.asarray(), crop(surface, found).all_in_focus)
    with tifffile.TiffFile(tmp_path / "w07.tif") as file:
        assert file.pages[0].description == "SIMULATED. All-in-focus image of defect 1."
    with pytest.raises(DatasetError, match="cut from the inspected surface, and it is not here"):
        written_klarf(FOUND, path, SAMPLE, images=True)


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
        (lambda text: text[1:], "is not a KLARF file"),
        (_replaced("DefectRecordSpec 17", "DefectRecordSpec 18"), "it names 17 of 18 columns"),
        (_replaced("ClassLookup 13", "ClassLookup 8"), "its class list names 13 of 8 classes"),
        (_replaced(" 1 3 69.7674 4 2;", " 1 3 69.7674 4;"), "its summary has 4 numbers in 5 columns"),
        (_replaced("0 0;\nSummarySpec", "0 0 9 9;\nSummarySpec"), "line 3 of its defects has 19 of 17 numbers"),
        (_replaced('"L-204";', '"L-204;'), "line 6 has a quotation mark that is not closed"),
        (_replaced("Slot 7;\n", "Slot 7 "), "a semicolon is missing before SampleCenterLocation"),
        (_replaced("Slot 7;", "Slot 7;\nDiePitch 900 800;"), "it states DiePitch more than once"),
        (_replaced("Slot 7;", "Slot 7;\nCoordinatesMirrored MAYBE;"), "its CoordinatesMirrored is MAYBE"),
        (_replaced("EndOfFile;", "EndOfFile;\nFileVersion 1 2;"), "another file follows its EndOfFile"),
        (lambda text: re.sub(r"\n 2 7\.250.*", "", text), "its summary counts 3 defects and 2 are listed"),
        (_replaced(" 5 -12.000 30.000", " 5"), "line 3 of its defects has 15 of 17 numbers"),
        (_replaced(" 2 7.250 701.000", " 2"), "line 2 of its defects has 15 of 17 numbers"),
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
def test_errors_are_reported(file: Path, damage: Callable[[str], str], says: str):
    damaged = damage(file.read_text())
    assert damaged != file.read_text()
    file.write_text(damaged)
    with pytest.raises(DatasetError, match=says) as fault:
        read_klarf(file)
    assert str(fault.value).count(". ") == 0


def test_without_a_summary_it_is_reported_that_nothing_was_counted(file: Path):
    file.write_text(file.read_text().replace("SummaryList", "SummaryLost"))
    assert read_klarf(file).notes == ("The file has no summary: missing records cannot be detected.",)


def test_lines_that_list_images_are_no_defects(file: Path):
    file.write_text(file.read_text().replace("6.000 0 0\n 2", "6.000 1\n 1 0\n 2"))
    assert [d.number for d in read_klarf(file).defects] == [1, 2, 5]


def test_numbers_of_a_defect_may_go_on_in_the_next_line(file: Path):
    expected = read_klarf(file)
    file.write_text(file.read_text().replace(" 5 -12.000", " 5\n -12.000"))
    assert read_klarf(file) == expected


def test_a_file_that_is_not_there_is_reported(tmp_path: Path):
    with pytest.raises(DatasetError, match="does not exist"):
        read_klarf(tmp_path / "gone.klarf")


OTHER_TOOL = """FileVersion 1 2;
FileTimestamp 03-14-26 09:41:07;
TiffSpec 6.0 G R;
InspectionStationID "OptiMake" "Edge 3" "0412";
SampleType WAFER;
ResultTimestamp 03-14-26 09:12:55;
LotID "A77";
SampleSize 1 200;
SetupID "TOPSIDE" 02-01-26 08:00:00;
StepID "METAL2";
SampleOrientationMarkType NOTCH;
OrientationMarkLocation DOWN;
DiePitch 5.0000000000e+03 4.0000000000e+03;
DieOrigin 0.000000 0.000000;
WaferID "05";
Slot 5;
SampleCenterLocation 2500.0 2000.0;
ClassLookup 2
 0 "None"
 7 "Scratch";
InspectionTest 1;
SampleTestPlan 2
 0 0
 1 0;
AreaPerTest 4.0e+07;
DefectRecordSpec 12 DEFECTID XREL YREL XINDEX YINDEX XSIZE YSIZE DEFECTAREA DSIZE CLASSNUMBER IMAGECOUNT IMAGELIST ;
TiffFileName A77_05_1.tif;
DefectList
 1 100.5 200.25 0.000 0.000 3.0 4.0 12.0 5.0 7 1 1
 1 0;
TiffFileName A77_05_2.tif;
DefectList
 2 300.0 400.0 1.000 0.000 3.0 4.0
 12.0 5.0 0 0 0
 3 301.0 401.0 1 0 3.0 4.0 12.0 5.0 7 1 1
 2 0;
InspectionTest 2;
SampleTestPlan 2
 1 0
 -1 1;
AreaPerTest 4.0e+07;
DefectRecordSpec 6 DEFECTID XINDEX YINDEX XREL YREL CLASSNUMBER ;
DefectList
 4 -1 1 50.0 60.0 7;
SummarySpec 5 TESTNO NDEFECT DEFDENSITY NDIE NDEFDIE ;
SummaryList
 1 3 0.075 2 2
 2 1 0.025 2 1;
EndOfFile;
"""
"""In the manner of a tool that starts a list for each image, writes indices as reals and wraps long lines."""


@pytest.fixture
def other_tool(tmp_path: Path) -> Path:
    path = tmp_path / "a77_05.001"
    path.write_text(OTHER_TOOL)
    return path


def test_all_lists_of_defects_are_read_each_under_its_own_columns(other_tool: Path):
    klarf = read_klarf(other_tool)
    places = [(d.number, d.col, d.row, d.u_um, d.v_um, d.class_name) for d in klarf.defects]
    assert places == [
        (1, 0, 0, 100.5, 200.25, "Scratch"),
        (2, 1, 0, 300.0, 400.0, "None"),
        (3, 1, 0, 301.0, 401.0, "Scratch"),
        (4, -1, 1, 50.0, 60.0, "Scratch"),
    ]
    assert [d.size_um for d in klarf.defects] == [5.0, 5.0, 5.0, 0.0]


def test_all_inspection_tests_are_read(other_tool: Path):
    klarf = read_klarf(other_tool)
    assert klarf.dies == ((0, 0), (1, 0), (-1, 1))
    assert klarf.inspected_um2 == 4e7
    assert klarf.notes == ("It holds 2 inspection tests: their dies and defects are shown together.",)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_a_byte_order_mark_is_no_part_of_the_text(other_tool: Path, encoding: str):
    expected = read_klarf(other_tool)
    other_tool.write_text(OTHER_TOOL, encoding=encoding)
    assert read_klarf(other_tool) == expected


def test_places_count_from_the_origin_of_the_dies(other_tool: Path):
    at_corner = read_klarf(other_tool)
    other_tool.write_text(OTHER_TOOL.replace("DieOrigin 0.000000 0.000000", "DieOrigin 40.0 -25.0"))
    klarf = read_klarf(other_tool)
    assert (klarf.defects[0].u_um, klarf.defects[0].v_um) == (140.5, 175.25), "from the lower left corner"
    assert (klarf.center_x_um, klarf.center_y_um) == (2540.0, 1975.0)
    for mine, theirs in zip(klarf.outlines(), at_corner.outlines(), strict=True):
        assert mine.points[0].x_um == pytest.approx(theirs.points[0].x_um)
        assert mine.points[0].y_um == pytest.approx(theirs.points[0].y_um)


def test_mirrored_coordinates_are_mirrored_back_about_the_centre(other_tool: Path):
    straight = read_klarf(other_tool)
    other_tool.write_text(OTHER_TOOL.replace("Slot 5;", "Slot 5;\nCoordinatesMirrored YES;"))
    klarf = read_klarf(other_tool)
    assert "Its coordinates are mirrored: x was mirrored back about the centre of the wafer." in klarf.notes
    for mine, theirs in zip(klarf.outlines(), straight.outlines(), strict=True):
        assert mine.points[0].x_um == pytest.approx(-theirs.points[0].x_um)
        assert mine.points[0].y_um == pytest.approx(theirs.points[0].y_um)
    assert klarf.dies == ((0, 0), (-1, 0), (1, 1))
    other_tool.write_text(OTHER_TOOL.replace("Slot 5;", "Slot 5;\nCoordinatesMirrored NO;"))
    assert read_klarf(other_tool) == straight


def test_a_half_index_is_no_index(other_tool: Path):
    other_tool.write_text(OTHER_TOOL.replace("1.000 0.000 3.0", "1.500 0.000 3.0"))
    with pytest.raises(DatasetError, match=r"damaged record \(1.500 is not a whole number\)"):
        read_klarf(other_tool)


def _facts(klarf: Klarf) -> Klarf:
    """Return a file without what differs between the versions, lengths rounded to .1 nm."""
    rounded = [replace(d, **{name: round(getattr(d, name), 4) for name in LENGTHS}) for d in klarf.defects]
    header = {name: round(getattr(klarf, name), 4) for name in HEADER_LENGTHS}
    return replace(klarf, version="", notes=(), defects=tuple(rounded), **header)


LENGTHS = ("u_um", "v_um", "width_um", "height_um", "size_um", "area_um2")
HEADER_LENGTHS = ("pitch_x_um", "pitch_y_um", "center_x_um", "center_y_um", "inspected_um2")


def test_both_versions_hold_the_same(file: Path, tmp_path: Path):
    nested = written_klarf(FOUND, tmp_path / "w07_18.klarf", SAMPLE, version="1.8")
    klarf = read_klarf(nested)
    assert (klarf.version, klarf.notes) == ("1.8", ("Lengths were converted from nm to um.",))
    assert _facts(klarf) == _facts(read_klarf(file))
    with pytest.raises(DatasetError, match=r"it states the unit nm, not um: leave the unit out"):
        read_klarf(nested, "um")
    with pytest.raises(DatasetError, match=r"KLARF 1.3 is not written: choose one of 1.2, 1.8"):
        written_klarf(FOUND, tmp_path / "w07_13.klarf", version="1.3")  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (lambda text: text[: len(text) // 2], "is cut off, it has no EndOfFile"),
        (_replaced("}\nEndOfFile", "EndOfFile"), "a brace is not closed before its EndOfFile"),
        (_replaced("Data 3", "Data 4"), "its DefectList has 3 of 4 rows"),
        (_replaced("1 100000 50500 0", "1 100000 0"), "row 1 of its DefectList has 14 of 15 values"),
        (_replaced("Columns 15", "Columns 14"), "its DefectList names 15 of 14 columns"),
        (_replaced("DiePitch 2", "DiePitch 3"), "its field DiePitch has 2 of 3 values"),
        (_replaced("1 3 69.7674", "1 4 69.7674"), "its summary counts 4 defects and 3 are listed"),
        (_replaced("List DefectList", "Listen DefectList"), "has 'Listen' where Record, Field or List is expected"),
        (_replaced('"1.8"', '"1.9"'), "it is KLARF 1.9 and not one of 1.8: export it as 1.2"),
        (
            _replaced('Record WaferRecord "W07"', 'Record WaferRecord "W08" {}\nRecord WaferRecord "W07"'),
            "several wafers",
        ),
    ],
)
def test_errors_of_the_nested_syntax_are_reported(tmp_path: Path, damage: Callable[[str], str], says: str):
    path = written_klarf(FOUND, tmp_path / "w07_18.klarf", SAMPLE, version="1.8")
    damaged = damage(path.read_text())
    assert damaged != path.read_text()
    path.write_text(damaged)
    with pytest.raises(DatasetError, match=says):
        read_klarf(path)


NESTED_TOOL = """Record FileRecord  "1.8"
{
  Record LotRecord "A77"
  {
    Record WaferRecord "05"
    {
      Field DieOrigin 2 {0, 0}
      Field OrientationInstructions 1 {"Back"}
      Field SampleCenterLocation 2 {2500000, 2000000}

      List DefectList
      {
        Columns 9 { int32 DEFECTID,  int32 XREL,  int32 YREL,  int32 XINDEX,  int32 YINDEX,
        int32 DSIZE,  float CONTRAST,  ImageList IMAGEINFO,  int32 CLASSNUMBER  }
        Data 2
        {
          1 100500 200250 0 0 5000
            0.0000 Images 2 { "a 1.jpg" "JPG" 1 "Patch", "a;2.jpg" "JPG" 1 "Patch" } 7 ;
          2 300000 400000 1 0 NA NA N 0 ;
        }
      }
      Record TestRecord "1" { Field AreaPerTest 1 {4.0e+013} Field InspectionTest 2 {1, "1"} }
    }
    Field DiePitch 2 {5000000, 4000000}
    Field OrientationMarkLocation 1 {0}
    Field SampleSize 2 {200000000, 0}
    List ClassLookupList
    {
      Columns 3 { int32 CLASSNUMBER, string CLASSNAME, string CLASSCODE }
      Data 2
      {
         0 "None" "";
         7 "Scratch" "";
      }
    }
  }
}
EndOfFile;
"""
"""In the manner of a tool that wraps rows, lists images within them and states what is of the lot behind its wafers."""


def test_the_nested_syntax_of_another_tool_is_read(tmp_path: Path):
    path = tmp_path / "a77_05.klarf"
    path.write_text(NESTED_TOOL)
    klarf = _facts(read_klarf(path))
    places = [(d.number, d.col, d.row, d.u_um, d.v_um, d.size_um, d.class_name) for d in klarf.defects]
    assert places == [(1, 0, 0, 100.5, 200.25, 5.0, "Scratch"), (2, 1, 0, 300.0, 400.0, 0.0, "None")]
    assert (klarf.lot, klarf.wafer, klarf.sample_mm, klarf.inspected_um2) == ("A77", "05", 200.0, 4e7)
    assert (klarf.pitch_x_um, klarf.center_x_um, klarf.center_y_um) == (5000.0, 2500.0, 2000.0)
    assert 'Its OrientationInstructions say "Back": its places are taken as they are.' in read_klarf(path).notes


@pytest.mark.parametrize(
    ("layout", "note"),
    [
        (_replaced("EndOfFile;", "EndOfFile;" + "\n" * 300), ()),
        (_replaced("EndOfFile;", "EndOfFile;\n\x1a\0\0"), ()),
        (_replaced("EndOfFile;", "EndOfFile;\nchecksum 17"), ("What follows EndOfFile was left out.",)),
        (_replaced("\n", "\r\n"), ()),
        (_replaced("\n", "\r"), ()),
        (_replaced(" 7 1 1\n 1 0;", " 7 1 1\n 1 0;\n"), ()),
        (_replaced(" 12.0 5.0 0 0 0\n 3", " 12.0 5.0 0 0 0;\n\n 3"), ()),
        (_replaced(" 0 0\n 1 0;", " 0 0;\n 1 0;"), ()),
        (str.upper, ()),
        (str.lower, ()),
        (
            _replaced('StepID "METAL2";', 'StepID "METAL2"'),
            ("A record has no semicolon and was taken to end before the next keyword.",),
        ),
    ],
)
def test_other_layouts_are_read_alike(other_tool: Path, layout: Callable[[str], str], note: tuple[str, ...]):
    expected = read_klarf(other_tool)
    other_tool.write_text(layout(OTHER_TOOL), newline="")
    klarf = read_klarf(other_tool)
    assert [(d.number, d.u_um, d.v_um, d.size_um) for d in klarf.defects] == [
        (d.number, d.u_um, d.v_um, d.size_um) for d in expected.defects
    ]
    assert (klarf.dies, klarf.pitch_x_um, klarf.notes) == (expected.dies, expected.pitch_x_um, note + expected.notes)
    assert klarf.step.upper() == expected.step


@pytest.mark.parametrize("encoding", ["cp1252", "latin-1"])
def test_western_text_is_read_with_a_note(other_tool: Path, encoding: str):
    other_tool.write_bytes(OTHER_TOOL.replace('"A77"', '"Größe µm é"').encode(encoding))
    klarf = read_klarf(other_tool)
    assert klarf.lot == "Größe µm é"
    assert klarf.notes[0].startswith("Its text is not UTF-8 and was read as Windows-1252")


@pytest.mark.parametrize("seed", range(4))
def test_random_files_are_read_equal_or_refused(tmp_path: Path, seed: int):
    """Fifty files a seed, with and without damage: none is read as what it does not hold."""
    rng = random.Random(seed)
    for _ in range(50):
        drawn = random_klarf(rng)
        path = tmp_path / "random.klarf"
        path.write_bytes(drawn.content)
        try:
            klarf = read_klarf(path)
        except DatasetError:
            assert drawn.damage, drawn.content
            continue
        doubted = drawn.damage and any("may not be detected" in note for note in klarf.notes)
        assert doubted or _facts(klarf) == _facts(drawn.klarf), (drawn.damage, drawn.content)
