"""Wafer maps: SEMI E142 and SINF hold the bin of every die in its place, read by parsers of their own."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from tests.support.datasets.inspections import defect, inspection
from wafer_viewer.model.acquisition.sample import Notch, Sample
from wafer_viewer.model.errors import DatasetError, MeasureError
from wafer_viewer.model.inspection.defect import DefectLimits, DefectRecipe, Inspection, die_bins
from wafer_viewer.model.spec import replace
from wafer_viewer.store.tables.wafer_map import CODES, MapFormat, write_wafer_map
from wafer_viewer.store.tables.wafer_map_reader import read_wafer_map

SAMPLE = Sample(lot="L<2>&é", wafer_id='W"07"', product="LX-7", slot=7, notch="left", width_um=1e5, height_um=1e5)
LIMITS = DefectLimits(max_per_die=1)
FOUND = inspection(
    defect(1, "0,0", 100.0, 50.5),
    defect(2, "0,0", 300.0, 50.5),
    defect(3, "1,0", 300.0, 50.5, judgement="nuisance"),
    defect(4, "1,0", 200.0, 50.5),
    defect(5, "2,0", 7.25, 301.0, kind="unmeasured"),
    defect(6, "2,0", 7.25, 101.0),
    states={"1,1": "not scanned", "0,1": "missing", "2,1": "cut"},
    recipe=DefectRecipe(product="LX-7", limits=LIMITS),
)
BINS = {
    (0, 0): "fail",
    (1, 0): "pass",
    (2, 0): "pass",
    (0, 1): "missing",
    (1, 1): "not inspected",
    (2, 1): "not inspected",
}


def read_e142(path: Path) -> tuple[dict[tuple[int, int], str], dict[str, str]]:
    """Read the description of the bin at each (x, y) from the upper left, and the facts of the file."""
    root = ET.parse(path).getroot()
    space = {"m": "urn:semi-org:xsd.E142-1.V1005.SubstrateMap"}
    found = root.find("m:SubstrateMaps/m:SubstrateMap", space)
    codes = root.find(".//m:BinCodeMap", space)
    assert found is not None
    assert codes is not None
    assert (found.get("OriginLocation"), found.get("AxisDirection")) == ("UpperLeft", "DownRight")
    names = {bin.get("BinCode"): bin.attrib for bin in codes.iterfind("m:BinDefinitions/m:BinDefinition", space)}
    bins: dict[tuple[int, int], str] = {}
    for y, row in enumerate(codes.iterfind("m:BinCode", space)):
        text = row.text or ""
        for x in range(len(text) // 2):
            if (code := text[2 * x : 2 * x + 2]) != codes.get("NullBin"):
                bins[x, y] = names[code]["BinDescription"]
    for name in names.values():
        assert int(name["BinCount"]) == list(bins.values()).count(name["BinDescription"])
    size = root.find("m:Layouts/m:Layout[@LayoutId='Dies']/m:Dimension", space)
    step = root.find("m:Layouts/m:Layout[@LayoutId='Dies']/m:StepSize", space)
    assert size is not None
    assert step is not None
    facts = {
        "wafer": found.get("SubstrateId", ""),
        "lot": root.findtext("m:Substrates/m:Substrate/m:LotId", "", space),
        "notch": found.get("Orientation", ""),
        "shape": f"{size.get('X')} x {size.get('Y')}",
        "step_mm": f"{step.get('X')} x {step.get('Y')}",
        "good": root.findtext("m:Substrates/m:Substrate/m:GoodDevices", "", space),
        "simulated": str("SIMULATED" in root.findall(".//m:Overlay", space)[0].get("MapName", "")),
    }
    return bins, facts


def read_sinf(path: Path) -> tuple[dict[tuple[int, int], str], dict[str, str]]:
    """Read the code at each (x, y) from the upper left, and the header."""
    lines = [line.split(":", 1) for line in path.read_text().splitlines()]
    rows = [value.split() for name, value in lines if name == "RowData"]
    header = {name: value for name, value in lines if name != "RowData"}
    assert (int(header["ROWCT"]), {int(header["COLCT"])}) == (len(rows), {len(row) for row in rows})
    bins = {(x, y): code for y, row in enumerate(rows) for x, code in enumerate(row) if code != "__"}
    assert int(header["DIECT"]) == len(bins)
    return bins, header


def in_map(bins: dict[tuple[int, int], str], top_row: int = 1) -> dict[tuple[int, int], str]:
    """Return the bins of dies by (x, y) from the upper left."""
    return {(col, top_row - row): bin for (col, row), bin in bins.items()}


def test_only_a_die_inspected_whole_and_within_the_limit_passes():
    assert die_bins(FOUND) == BINS
    assert die_bins(FOUND, DefectLimits(max_per_die=0))[1, 0] == "fail"
    with pytest.raises(MeasureError, match=r"set max_per_die \(--max-per-die\)"):
        die_bins(FOUND, DefectLimits(max_per_mm2=3.0))


def test_e142_has_every_die_in_its_place(tmp_path: Path):
    bins, facts = read_e142(write_wafer_map(FOUND, tmp_path / "w07.xml", SAMPLE))
    assert bins == in_map(BINS)
    assert facts == {
        "wafer": 'W"07"',
        "lot": "L<2>&é",
        "notch": "90",
        "shape": "3 x 2",
        "step_mm": "1.000000 x 0.800000",
        "good": "2",
        "simulated": "True",
    }


def test_sinf_has_every_die_in_its_place(tmp_path: Path):
    bins, header = read_sinf(write_wafer_map(FOUND, tmp_path / "w07.sinf", SAMPLE, format="sinf"))
    codes = {"pass": "01", "fail": "0B", "missing": "0C", "not inspected": "@@"}
    assert bins == {place: codes[bin] for place, bin in in_map(BINS).items()}
    assert header["BCEQU"] == codes["pass"]
    assert (header["LOT"], header["WAFER"], header["DEVICE"], header["FNLOC"]) == ("L<2>&é", 'W"07"', "LX-7", "270")
    assert (header["DUTMS"], header["XDIES"], header["YDIES"]) == ("mm", "1.000000", "0.800000")
    assert header["COMMENT"].startswith("SIMULATED. The first position is die 0,1")


def without_corner() -> Inspection:
    """Return an inspection whose lattice begins at -2,5 and has no die upper right."""
    dies = tuple(
        status.__class__(name=f"{c},{r}", col=c, row=r, state="whole", measured_fraction=1.0, defects=0)
        for status in FOUND.dies[:1]
        for c, r in ((-2, 5), (-1, 5), (-2, 6))
    )
    return inspection(dies=dies, simulated=False, recipe=DefectRecipe(limits=LIMITS))


@pytest.mark.parametrize(
    ("notch", "e142", "sinf"),
    [("down", "0", "180"), ("left", "90", "270"), ("up", "180", "0"), ("right", "270", "90")],
)
def test_places_without_a_die_are_null_and_the_notch_is_stated(tmp_path: Path, notch: Notch, e142: str, sinf: str):
    found, sample = without_corner(), Sample(notch=notch)
    bins, facts = read_e142(write_wafer_map(found, tmp_path / "w.xml", sample))
    codes, header = read_sinf(write_wafer_map(found, tmp_path / "w.sinf", sample, format="sinf"))
    assert set(bins) == set(codes) == {(0, 0), (0, 1), (1, 1)}
    assert (facts["notch"], header["FNLOC"], facts["simulated"]) == (e142, sinf, "False")
    assert "The first position is die -2,6" in header["COMMENT"]


def test_what_a_map_cannot_hold_is_refused_and_leaves_no_file(tmp_path: Path):
    without_dies = inspection(grid=None, dies=())
    with pytest.raises(DatasetError, match="A wafer map shows dies and this inspection has none"):
        write_wafer_map(without_dies, tmp_path / "w.xml")
    with pytest.raises(MeasureError, match="set max_per_die"):
        write_wafer_map(inspection(), tmp_path / "w.xml")
    with pytest.raises(DatasetError, match=r"the side of the notch, and it is not known: give it \(--notch\)"):
        write_wafer_map(FOUND, tmp_path / "w.xml", Sample())
    with pytest.raises(DatasetError, match="are not written as g85: choose one of e142, sinf"):
        write_wafer_map(FOUND, tmp_path / "w.xml", SAMPLE, format="g85")  # pyright: ignore[reportArgumentType]
    with pytest.raises(DatasetError, match="its folder does not exist"):
        write_wafer_map(FOUND, tmp_path / "gone" / "w.xml", SAMPLE)
    assert not list(tmp_path.iterdir())


# -------------------------------------------------------------------------------------------------------------- reading


@pytest.mark.parametrize("format", ["e142", "sinf"])
@pytest.mark.parametrize("found", [FOUND, without_corner()], ids=["whole", "without corner"])
def test_what_is_written_is_read_back(tmp_path: Path, format: MapFormat, found: Inspection):
    sample = replace(SAMPLE, notch="right")
    stored = read_wafer_map(write_wafer_map(found, tmp_path / "w.map", sample, format=format))
    bins = die_bins(found)
    assert {place: CODES_READ[format][die.code] for place, die in stored.on(found.dies).items()} == bins
    qualities = {"pass": "pass", "fail": "fail", "missing": "fail", "not inspected": "skip"}
    assert {place: die.quality for place, die in stored.on(found.dies).items()} == {
        place: qualities[bin] for place, bin in bins.items()
    }
    assert (stored.notch, stored.lot, stored.wafer) == ("right", "L<2>&é", 'W"07"')
    assert (stored.pitch_x_um, stored.pitch_y_um) == (1000.0, 800.0)
    assert (stored.width_um, stored.height_um) == ((950.0, 760.0) if format == "e142" else (0.0, 0.0))


CODES_READ = {
    "e142": {code: bin for bin, code in CODES.items()},
    "sinf": {code: bin for bin, code in CODES.items()} | {"@@": "not inspected"},
}
OTHER_SINF = """DEVICE:VP3920
LOT:G6A840.2
WAFER:22
FNLOC:90
ROWCT:2
COLCT:3
BCEQU:01 02
DUTMS:mil
XDIES:100.000
YDIES:60.000
RowData:__ 01 0C
RowData:02 @@ __
"""
"""In the manner of another tool: mils, two good codes, no reference die, notch at the right."""


def test_a_map_of_another_tool_is_turned_to_the_notch_of_the_wafer(tmp_path: Path):
    (path := tmp_path / "other.sinf").write_text(OTHER_SINF)
    stored = read_wafer_map(path)
    assert (stored.pitch_x_um, stored.pitch_y_um, stored.notch) == (2540.0, pytest.approx(1524.0), "right")
    places = {(die.col, die.row): die.quality for die in stored.dies}
    assert places == {(1, 1): "pass", (2, 1): "fail", (0, 0): "pass", (1, 0): "skip"}
    turned = stored.turned("down")  # clockwise: what was at the right is at the bottom
    assert {(die.col, die.row): die.code for die in turned.dies} == {
        (1, 1): "01",
        (1, 0): "0C",
        (0, 2): "02",
        (0, 1): "@@",
    }
    assert (turned.cols, turned.rows, turned.pitch_x_um) == (2, 3, pytest.approx(1524.0))
    assert stored.turned("left").turned("down").turned("right") == stored
    assert stored.on(FOUND.dies)[2, 1].code == "0C"
    with pytest.raises(DatasetError, match="2 x 3 dies and this wafer 3 x 2, and it does not state which is die 0,0"):
        stored.on(FOUND.dies, "down")


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("ROWCT:2", "ROWCT:3", "it states ROWCT 3 and has 2"),
        ("RowData:__ 01 0C", "RowData:__ 01", "its rows are not equally long"),
        ("RowData", "Row", "it is neither XML nor has it lines of RowData"),
        ("DUTMS:mil", "DUTMS:ell", "its unit is 'ell'"),
        ("FNLOC:90", "FNLOC:east", "it has a damaged record"),
    ],
)
def test_a_damaged_sinf_is_refused(tmp_path: Path, old: str, new: str, says: str):
    (path := tmp_path / "other.sinf").write_text(OTHER_SINF.replace(old, new))
    with pytest.raises(DatasetError, match=says):
        read_wafer_map(path)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("UpperLeft", "Center", "its OriginLocation is Center, which is no corner"),
        ("HexaDecimal", "Runes", "its BinType is Runes"),
        ("<BinCode>0B", "<BinCode>0", "row 2 of its bins has 5 letters, 2 to a code"),
        ("<BinCode>0B", "<BinCode>", "its rows are not equally long"),
        ("Overlay", "Underlay", "it has 0 maps of bin codes where 1 is expected"),
        ("</MapData>", "", "it has a damaged record"),
        ("<MapData", "<!DOCTYPE a><MapData", "it defines entities"),
    ],
)
def test_a_damaged_e142_is_refused(tmp_path: Path, old: str, new: str, says: str):
    path = write_wafer_map(FOUND, tmp_path / "w.xml", SAMPLE)
    text = path.read_text()
    path.write_text(text.replace(old, new))
    assert path.read_text() != text
    with pytest.raises(DatasetError, match=says):
        read_wafer_map(path)


def test_rows_of_e142_may_begin_at_any_corner(tmp_path: Path):
    path = write_wafer_map(FOUND, tmp_path / "w.xml", SAMPLE)
    upper_left = {(d.col, d.row): d.code for d in read_wafer_map(path).dies}
    path.write_text(path.read_text().replace("UpperLeft", "LowerRight"))
    assert {(2 - d.col, 1 - d.row): d.code for d in read_wafer_map(path).dies} == upper_left
