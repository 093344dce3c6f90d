"""Wafer maps: SEMI E142 and SINF hold the bin of every die in its place, read by parsers of their own."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from tests.support.datasets.inspections import defect, inspection
from wafer_viewer.model.acquisition.sample import Notch, Sample
from wafer_viewer.model.errors import DatasetError, MeasureError
from wafer_viewer.model.inspection.defect import DefectLimits, DefectRecipe, Inspection, die_bins
from wafer_viewer.store.tables.wafer_map import write_wafer_map

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
    [("down", "0", "180"), ("left", "90", "270"), ("up", "180", "0"), ("right", "270", "90"), ("none", "0", "180")],
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
    with pytest.raises(DatasetError, match="are not written as g85: choose one of e142, sinf"):
        write_wafer_map(FOUND, tmp_path / "w.xml", format="g85")  # pyright: ignore[reportArgumentType]
    with pytest.raises(DatasetError, match="its folder does not exist"):
        write_wafer_map(FOUND, tmp_path / "gone" / "w.xml")
    assert not list(tmp_path.iterdir())
