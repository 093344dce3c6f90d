"""Wafer maps for die bonders and yield systems: SEMI E142 (XML) and SINF (text), the bins of the dies of an inspection.

Rows go from the top down and columns from left to right, along the axes of the lattice on the stage; both formats say
where the notch points on this map. Codes are hexadecimal and the same in both formats.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree as ET

from wafer_viewer.model.acquisition.sample import Notch, Sample
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.inspection.defect import DieBin, Inspection, die_bins
from wafer_viewer.model.inspection.die_grid import DieGrid
from wafer_viewer.model.inspection.wafer_map import require_notch
from wafer_viewer.store.io.atomic_files import write_text

MapFormat = Literal["e142", "sinf"]
CODES: dict[DieBin, str] = {"pass": "01", "fail": "0B", "missing": "0C", "not inspected": "0D"}
QUALITIES: dict[DieBin, str] = {"pass": "Pass", "fail": "Fail", "missing": "Fail", "not inspected": "Skip"}
"""BinQuality of SEMI E142; a die that is to be skipped is neither good nor bad."""
NULL_CODE, SINF_NULL, SINF_NOT_INSPECTED = "FF", "__", "@@"
E142_NAMESPACE = "urn:semi-org:xsd.E142-1.V1005.SubstrateMap"
E142_NOTCH_DEG: dict[Notch, int] = {"down": 0, "left": 90, "up": 180, "right": 270}
"""Orientation of SEMI E142, clockwise from the bottom of the map."""
SINF_NOTCH_DEG: dict[Notch, int] = {"up": 0, "right": 90, "down": 180, "left": 270}
"""FNLOC of SINF, clockwise from the top of the map."""
FIRST_DIE = "The first position is die {}, upper left."
"""Sentence of the comment; reference dies are avoided, as programs count their places from 0 or from 1."""
_UM_PER_MM = 1000.0
_MAP, _LAYOUT = "WaferLayout", "Dies"


def write_wafer_map(
    inspection: Inspection, path: str | Path, sample: Sample = Sample(), *, format: MapFormat = "e142"
) -> Path:
    """Write the dies of an inspection with their bins to a wafer map.

    Parameters
    ----------
    inspection : Inspection
        Result of a defect inspection with dies and a limit of defects per die.
    path : str or Path
        File to write; an existing file is replaced.
    sample : Sample, optional
        Identification of the wafer: lot, wafer id, product, slot, and the notch, which must be known. Default: empty.
    format : {"e142", "sinf"}, default "e142"
        SEMI E142 is XML, SINF is text.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    DatasetError
        When the inspection has no dies, the notch is not known, the format is another, or the file cannot be written.
    MeasureError
        When no limit of defects per die is set.

    Notes
    -----
    Bins: 01 pass, 0B fail (more defects than permitted, nuisances aside), 0C missing die, 0D not inspected (SINF: @@),
    FF no die (SINF: __). Only a die that was scanned and inspected completely passes; see `die_bins`. Rows go from the
    top down and columns from left to right, along the axes of the lattice on the stage. Orientation (E142) is the notch
    clockwise from the bottom of the map, FNLOC (SINF) from its top, both in degrees. A comment names the first position
    by its die and states whether the wafer is simulated.

    References
    ----------
    SEMI E142, Specification for Substrate Mapping. SINF: Simplified Integrator Nested Format, as described by Artwork
    Conversion Software, https://www.artwork.com/package/wmapconvert/map_formats/SINF/.
    """
    if inspection.grid is None or not inspection.dies:
        raise DatasetError("A wafer map shows dies and this inspection has none: give their pitch, or write a CSV.")
    if format not in ("e142", "sinf"):
        raise DatasetError(f"Wafer maps are not written as {format}: choose one of e142, sinf.")
    bins = _rows(die_bins(inspection))
    require_notch(sample.notch)
    text = (_e142 if format == "e142" else _sinf)(inspection, inspection.grid, sample, bins)
    write_text(Path(path), text)
    return Path(path)


def _rows(bins: dict[tuple[int, int], DieBin]) -> list[list[DieBin | None]]:
    """Return the bins of each row from the top down; None where no die is."""
    cols, rows = (sorted(part) for part in zip(*bins, strict=True))
    return [[bins.get((col, row)) for col in range(cols[0], cols[-1] + 1)] for row in range(rows[-1], rows[0] - 1, -1)]


def _comment(inspection: Inspection, grid: DieGrid, sample: Sample) -> str:
    first = grid.name(min(die.col for die in inspection.dies), max(die.row for die in inspection.dies))
    simulated = "SIMULATED. " if inspection.simulated else ""
    return f"{simulated}{FIRST_DIE.format(first)} The notch points {sample.notch} on this map."


def _plain(text: str) -> str:
    """Return a text in one line, without control characters."""
    return "".join(letter for letter in " ".join(text.split()) if letter.isprintable())


def _e142(inspection: Inspection, grid: DieGrid, sample: Sample, bins: list[list[DieBin | None]]) -> str:
    counts = Counter(die for row in bins for die in row if die is not None)
    root = ET.Element("MapData", xmlns=E142_NAMESPACE)
    root.append(ET.Comment(f" {_comment(inspection, grid, sample)} "))
    _add_layouts(root, inspection, grid, sample, (len(bins[0]), len(bins)))
    wafer = {"SubstrateType": "Wafer", "SubstrateId": _plain(sample.wafer_id or sample.name)}
    substrate = ET.SubElement(ET.SubElement(root, "Substrates"), "Substrate", wafer)
    for name, text in (("LotId", _plain(sample.lot)), ("SlotNumber", f"{sample.slot or ''}")):
        if text:
            ET.SubElement(substrate, name).text = text
    ET.SubElement(substrate, "GoodDevices").text = str(counts["pass"])
    places = {
        "LayoutSpecifier": f"{_MAP}/{_LAYOUT}",
        "SubstrateSide": "TopSide",
        "Orientation": str(E142_NOTCH_DEG[sample.notch]),
        "OriginLocation": "UpperLeft",
        "AxisDirection": "DownRight",
    }
    substrate_map = ET.SubElement(ET.SubElement(root, "SubstrateMaps"), "SubstrateMap", wafer | places)
    name = "SIMULATED inspection" if inspection.simulated else "Inspection"
    overlay = ET.SubElement(substrate_map, "Overlay", MapName=name, MapVersion="1")
    codes = ET.SubElement(overlay, "BinCodeMap", BinType="HexaDecimal", NullBin=NULL_CODE, MapType="2DArray")
    definitions = ET.SubElement(codes, "BinDefinitions")
    for die, code in CODES.items():
        values = {"BinCode": code, "BinCount": str(counts[die]), "BinQuality": QUALITIES[die], "BinDescription": die}
        ET.SubElement(definitions, "BinDefinition", values)
    for row in bins:
        ET.SubElement(codes, "BinCode").text = "".join(NULL_CODE if die is None else CODES[die] for die in row)
    ET.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ET.tostring(root, encoding="unicode")}\n'


def _add_layouts(
    root: ET.Element, inspection: Inspection, grid: DieGrid, sample: Sample, shape: tuple[int, int]
) -> None:
    """Add the layout of the wafer, which holds one array, and that of its dies; lengths in mm."""
    layouts = ET.SubElement(root, "Layouts")
    whole = ET.SubElement(layouts, "Layout", LayoutId=_MAP, DefaultUnits="mm", TopLevel="true")
    ET.SubElement(whole, "Dimension", X="1", Y="1")
    if sample.size_um is not None:
        _add_lengths(whole, "DeviceSize", *sample.size_um)
    ET.SubElement(ET.SubElement(whole, "ChildLayouts"), "ChildLayout", LayoutId=_LAYOUT)
    dies = ET.SubElement(layouts, "Layout", LayoutId=_LAYOUT, DefaultUnits="mm")
    ET.SubElement(dies, "Dimension", X=str(shape[0]), Y=str(shape[1]))
    _add_lengths(dies, "DeviceSize", grid.width_um, grid.height_um)
    _add_lengths(dies, "StepSize", grid.pitch_x_um, grid.pitch_y_um)
    if product := _plain(inspection.product or sample.product):
        ET.SubElement(dies, "ProductId").text = product


def _add_lengths(parent: ET.Element, name: str, x_um: float, y_um: float) -> None:
    ET.SubElement(parent, name, X=f"{x_um / _UM_PER_MM:.6f}", Y=f"{y_um / _UM_PER_MM:.6f}")


def _sinf(inspection: Inspection, grid: DieGrid, sample: Sample, bins: list[list[DieBin | None]]) -> str:
    codes = {**CODES, None: SINF_NULL, "not inspected": SINF_NOT_INSPECTED}
    lines = [
        f"DEVICE:{_plain(inspection.product or sample.product)}",
        f"LOT:{_plain(sample.lot)}",
        f"WAFER:{_plain(sample.wafer_id or sample.name)}",
        f"FNLOC:{SINF_NOTCH_DEG[sample.notch]}",
        f"ROWCT:{len(bins)}",
        f"COLCT:{len(bins[0])}",
        f"BCEQU:{CODES['pass']}",
        "REFPX:",
        "REFPY:",
        "DUTMS:mm",
        f"DIECT:{sum(die is not None for row in bins for die in row)}",
        f"XDIES:{grid.pitch_x_um / _UM_PER_MM:.6f}",
        f"YDIES:{grid.pitch_y_um / _UM_PER_MM:.6f}",
        f"COMMENT:{_comment(inspection, grid, sample)}",
        *(f"RowData:{' '.join(codes[die] for die in row)}" for row in bins),
    ]
    return "\n".join(lines) + "\n"
