"""KLARF, the exchange format of inspection tools and yield systems: writer of versions 1.2 and 1.8, with images.

Lengths in um, in version 1.8 in nm. HEIGHT, signed, is an additional column that other readers ignore. The test plan
contains only dies that were inspected completely or that have defects: a die that was not or only partly scanned must
not appear clean. Images are the pages of one TIFF next to the file.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Literal

import numpy as np

from wafer_viewer.model.acquisition.sample import Sample
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.inspection.defect import Defect, Inspection, crop
from wafer_viewer.model.inspection.die_grid import DieGrid, DieStatus
from wafer_viewer.model.inspection.klarf import BINS, UM_PER_MM, KlarfExport, KlarfImage
from wafer_viewer.model.surface.height_map import Mosaic
from wafer_viewer.store.io.atomic_files import atomic_write, write_text
from wafer_viewer.store.tables.klarf import SIMULATED, SUMMARY_COLUMNS

KlarfVersion = Literal["1.2", "1.8"]
ColumnKind = Literal["count", "length", "area"]
COLUMNS: dict[str, ColumnKind] = {
    **dict.fromkeys(("DEFECTID",), "count"),
    **dict.fromkeys(("XREL", "YREL"), "length"),
    **dict.fromkeys(("XINDEX", "YINDEX"), "count"),
    **dict.fromkeys(("XSIZE", "YSIZE"), "length"),
    "DEFECTAREA": "area",
    "DSIZE": "length",
    **dict.fromkeys(("CLASSNUMBER", "TEST", "CLUSTERNUMBER", "ROUGHBINNUMBER", "FINEBINNUMBER"), "count"),
    "HEIGHT": "length",
}
IMAGE_COLUMNS = ("IMAGECOUNT", "IMAGELIST")
NM_PER_UM = 1000.0
MM2_PER_CM2, UM2_PER_MM2 = 100.0, 1e6


def write_klarf(
    inspection: Inspection,
    path: str | Path,
    sample: Sample = Sample(),
    stated: KlarfExport = KlarfExport(),
    *,
    surface: Mosaic | None = None,
    at: datetime | None = None,
    version: KlarfVersion = "1.2",
) -> Path:
    """Write the defects of an inspection to a KLARF file.

    Parameters
    ----------
    inspection : Inspection
        Result of a defect inspection with a die grid. Unmeasured areas are not written.
    path : str or Path
        File to write; an existing file is replaced.
    sample : Sample, optional
        Identification of the wafer: lot, wafer id, slot, notch and size. Default: empty.
    stated : KlarfExport, optional
        Stage position of the wafer centre, notch and diameter (default: those of the sample), and process step.
    surface : Mosaic, optional
        Inspected surface, from which the images are cut if `stated` asks for them.
    at : datetime, optional
        Time stamp of the file. Default: now.
    version : {"1.2", "1.8"}, default "1.2"
        Version of the format.

    Returns
    -------
    Path
        The file written. Images are the pages of a TIFF of the same name, ending ``.tif``.

    Raises
    ------
    DatasetError
        When the inspection has no die grid, the wafer centre, notch, diameter or step is not known, images are to be
        cut and there is no surface, the version is another, or a file cannot be written.

    Notes
    -----
    Lengths are in um, in version 1.8 in whole nm. XREL and YREL are the centre of a defect relative to the lower left
    corner of its die, along the axes of the lattice; SampleCenterLocation is the wafer centre relative to the lower
    left corner of die 0,0. HEIGHT, signed, is an additional column that other readers ignore. The test plan contains
    only dies that were inspected completely or that have defects: a die that was not or only partly scanned must not
    appear clean. ROUGHBINNUMBER is the judgement: 0 open, 1 real, 2 nuisance.
    """
    place = Path(path)
    if inspection.grid is None:
        raise DatasetError("KLARF gives places by dies and this inspection has none: give their pitch, or write a CSV.")
    if version not in _WRITERS:
        raise DatasetError(f"KLARF {version} is not written: choose one of {', '.join(_WRITERS)}.")
    complete = stated.over(KlarfExport.of(sample))
    complete.require_complete()
    images = _write_images(inspection, surface, place.with_suffix(".tif")) if complete.images else {}
    source = _Source(inspection, inspection.grid, sample, complete, at or datetime.now(), images)
    write_text(place, "\n".join(_WRITERS[version](source)) + "\n")
    return place


@dataclass(frozen=True, slots=True)
class _Source:
    """Contents of a file; images by the numbers of their defects."""

    inspection: Inspection
    grid: DieGrid
    sample: Sample
    stated: KlarfExport
    at: datetime
    images: dict[int, KlarfImage] = field(default_factory=dict[int, KlarfImage])

    @property
    def center_from_die(self) -> tuple[float, float]:
        """Centre of the wafer from the lower left corner of die 0,0, along the axes of the lattice."""
        col, row, u, v = _in_die(self.grid, self.stated.center_x_um or 0.0, self.stated.center_y_um or 0.0)
        return col * self.grid.pitch_x_um + u, row * self.grid.pitch_y_um + v

    @property
    def tiff_file(self) -> str:
        """Name of the file with the images; empty for none."""
        return next((image.file for image in self.images.values()), "")


def _write_images(inspection: Inspection, surface: Mosaic | None, path: Path) -> dict[int, KlarfImage]:
    """Write the all-in-focus image of each defect to a page of a TIFF."""
    import tifffile

    if surface is None:
        raise DatasetError("The images of a KLARF are cut from the inspected surface, and it is not here.")
    if not inspection.found:
        return {}
    text = "SIMULATED. " if inspection.simulated else ""
    with atomic_write(path) as temporary, tifffile.TiffWriter(temporary) as file:
        for defect in inspection.found:
            description = f"{text}All-in-focus image of defect {defect.number}."
            picture = crop(surface, defect).all_in_focus
            file.write(picture, photometric="minisblack", description=description, metadata=None)
    return {d.number: KlarfImage(file=path.name, page=page) for page, d in enumerate(inspection.found, 1)}


def _flat_lines(source: _Source) -> Iterator[str]:
    yield from _head(source)
    yield from _lattice(source)
    yield from _class_records(source.inspection)
    yield from _plan(source.inspection)
    yield from _defect_records(source)
    yield from _summary(source.inspection)
    yield "EndOfFile;"


def _head(source: _Source) -> Iterator[str]:
    stamp, inspection = " ".join(_stamp(source.at)), source.inspection
    yield "FileVersion 1 2;"
    yield f"FileTimestamp {stamp};"
    if source.images:
        yield "TiffSpec 6.0 G R;"
    yield f"InspectionStationID {' '.join(map(_quoted, _station(inspection)))};"
    yield "SampleType WAFER;"
    yield f"ResultTimestamp {stamp};"
    yield f"LotID {_quoted(source.sample.lot)};"
    yield f"SampleSize 1 {source.stated.diameter_mm or 0.0:g};"
    yield f"DeviceID {_quoted(inspection.product or source.sample.product)};"
    yield f"SetupID {_quoted(inspection.recipe.name)} {stamp};"
    yield f"StepID {_quoted(source.stated.step)};"


def _lattice(source: _Source) -> Iterator[str]:
    grid, sample, (center_x_um, center_y_um) = source.grid, source.sample, source.center_from_die
    yield "SampleOrientationMarkType NOTCH;"
    yield f"OrientationMarkLocation {source.stated.notch.upper()};"
    yield f"DiePitch {grid.pitch_x_um:.6f} {grid.pitch_y_um:.6f};"
    yield "DieOrigin 0.000000 0.000000;"
    yield f"WaferID {_quoted(sample.wafer_id or sample.name)};"
    yield f"Slot {sample.slot};"
    yield f"SampleCenterLocation {center_x_um:.6f} {center_y_um:.6f};"


def _stamp(at: datetime) -> tuple[str, str]:
    return f"{at:%m-%d-%Y}", f"{at:%H:%M:%S}"


def _station(inspection: Inspection) -> tuple[str, str, str]:
    return "Wafer Viewer", SIMULATED if inspection.simulated else "shape from focus", "0"


def _in_die(grid: DieGrid, x_um: float, y_um: float) -> tuple[int, int, float, float]:
    """Return (col, row, u_um, v_um) of one stage position."""
    col, row, u, v = grid.to_die(np.asarray(x_um), np.asarray(y_um))
    return int(col), int(row), float(u), float(v)


def _class_records(inspection: Inspection) -> Iterator[str]:
    classes = _classes(inspection)
    yield f"ClassLookup {len(classes)}"
    rows = [f" {number} {_quoted(title)}" for number, title in classes.items()]
    yield "\n".join(rows) + ";"


def _classes(inspection: Inspection) -> dict[int, str]:
    return {0: "Unclassified"} | inspection.recipe.class_table.numbers


def _plan(inspection: Inspection) -> Iterator[str]:
    """Yield the inspected dies and their area."""
    dies = _looked_at(inspection)
    yield "InspectionTest 1;"
    yield f"SampleTestPlan {len(dies)}{'' if dies else ';'}"
    yield from (f" {die.col} {die.row}{';' if die is dies[-1] else ''}" for die in dies)
    yield "InspectedAreaOrigin 0.000000 0.000000;"
    yield f"AreaPerTest {inspection.inspected_mm2 * UM2_PER_MM2:.6e};"


def _defect_records(source: _Source) -> Iterator[str]:
    found = source.inspection.found
    names = (*COLUMNS, *IMAGE_COLUMNS)
    yield f"DefectRecordSpec {len(names)} {' '.join(names)} ;"
    if source.tiff_file:
        yield f"TiffFileName {source.tiff_file};"
    yield f"DefectList{'' if found else ';'}"
    yield from (f" {_record(defect, source)}{';' if defect is found[-1] else ''}" for defect in found)


def _record(defect: Defect, source: _Source) -> str:
    """Return the line of a defect; in that below, its image is a page of the TIFF, of kind 0."""
    values = zip(COLUMNS.values(), _values(defect, source), strict=True)
    line = " ".join(f"{value}" if kind == "count" else f"{value:.3f}" for kind, value in values)
    image = source.images.get(defect.number)
    return f"{line} 0 0" if image is None else f"{line} 1 1\n {image.page} 0"


def _values(defect: Defect, source: _Source) -> tuple[float, ...]:
    """Return the values of a defect in the order of `COLUMNS`, in um and um2."""
    col, row, u, v = _in_die(source.grid, defect.center.x_um, defect.center.y_um)
    x0, y0, x1, y1 = defect.outline.bounds_um
    places, sizes = (defect.number, u, v, col, row), (x1 - x0, y1 - y0, defect.area.value, defect.major.value_um)
    labels = (source.inspection.recipe.class_table[defect.seen_as].klarf_number, 1, 0, BINS[defect.judgement], 0)
    return *places, *sizes, *labels, defect.height.value_um


def _looked_at(inspection: Inspection) -> list[DieStatus]:
    """Return the dies whose defect state is known."""
    return [die for die in inspection.dies if die.defects or (die.state == "whole" and die.defects is not None)]


def _summary(inspection: Inspection) -> Iterator[str]:
    yield f"SummarySpec {len(SUMMARY_COLUMNS)} {' '.join(SUMMARY_COLUMNS)} ;"
    yield "SummaryList"
    yield f" {' '.join(_counts(inspection))};"


def _counts(inspection: Inspection) -> tuple[str, ...]:
    """Return the values of `SUMMARY_COLUMNS`: the density is per cm2."""
    found, plan = inspection.found, _looked_at(inspection)
    area_cm2 = inspection.inspected_mm2 / MM2_PER_CM2
    density = len(found) / area_cm2 if area_cm2 else 0.0
    return "1", str(len(found)), f"{density:.4f}", str(len(plan)), str(sum(bool(die.defects) for die in plan))


def _quoted(text: str) -> str:
    """Return a quoted text; double quotes in it become single ones, as KLARF cannot escape them."""
    return '"' + " ".join(text.replace('"', "'").split()) + '"'


# ---------------------------------------------------------------------------------------------------------- version 1.8


def _nested_lines(source: _Source) -> Iterator[str]:
    sample = source.sample
    yield from _block(
        'Record FileRecord "1.8"',
        _field("FileTimestamp", *map(_quoted, _stamp(source.at))),
        *_block(
            f"Record LotRecord {_quoted(sample.lot)}",
            *_lot_fields(source),
            *_block(
                f"Record WaferRecord {_quoted(sample.wafer_id or sample.name)}",
                _field("DieOrigin", 0, 0),
                _field("OrientationInstructions", '""'),
                _field("SampleCenterLocation", *map(_nm, source.center_from_die)),
                _field("SlotNumber", sample.slot),
                *_wafer_lists(source),
            ),
        ),
    )
    yield "EndOfFile;"


def _lot_fields(source: _Source) -> Iterator[str]:
    inspection, grid, stamp = source.inspection, source.grid, _stamp(source.at)
    codes = {entry.klarf_number: entry.code for entry in inspection.recipe.class_table.offered}
    classes = [f"{n} {_quoted(title)} {_quoted(codes.get(n, ''))}" for n, title in _classes(inspection).items()]
    yield _field("InspectionStationID", *map(_quoted, _station(inspection)))
    yield _field("SampleType", '"WAFER"')
    yield _field("ResultTimestamp", *map(_quoted, stamp))
    yield _field("SampleSize", _nm((source.stated.diameter_mm or 0.0) * UM_PER_MM), 0)
    yield _field("DeviceID", _quoted(inspection.product or source.sample.product))
    yield _field("RecipeID", *map(_quoted, (inspection.recipe.name, *stamp)))
    yield _field("StepID", _quoted(source.stated.step))
    yield _field("SampleOrientationMarkType", '"NOTCH"')
    yield _field("OrientationMarkLocation", _quoted(source.stated.notch.upper()))
    yield _field("DiePitch", _nm(grid.pitch_x_um), _nm(grid.pitch_y_um))
    columns = ("int32 CLASSNUMBER", "string CLASSNAME", "string CLASSCODE")
    yield from _list("ClassLookupList", columns, classes)


def _wafer_lists(source: _Source) -> Iterator[str]:
    inspection = source.inspection
    columns = [f"{'float' if kind == 'area' else 'int32'} {name}" for name, kind in COLUMNS.items()]
    columns += ["int32 IMAGECOUNT", "ImageList IMAGEINFO"] if source.images else []
    yield from _list("DefectList", columns, [_nested_record(defect, source) for defect in inspection.found])
    yield from _block(
        'Record TestRecord "1"',
        _field("AreaPerTest", f"{inspection.inspected_mm2 * UM2_PER_MM2 * NM_PER_UM**2:.6e}"),
        *_list(
            "SampleTestPlanList",
            ("int32 XINDEX", "int32 YINDEX"),
            [f"{die.col} {die.row}" for die in _looked_at(inspection)],
        ),
    )
    columns = [f"{'float' if name == 'DEFDENSITY' else 'int32'} {name}" for name in SUMMARY_COLUMNS]
    yield from _block("Record SummaryRecord", *_list("TestSummaryList", columns, [" ".join(_counts(inspection))]))


def _nested_record(defect: Defect, source: _Source) -> str:
    texts = {"count": str, "length": lambda um: str(_nm(um)), "area": lambda um2: f"{um2 * NM_PER_UM**2:.1f}"}
    values = zip(COLUMNS.values(), _values(defect, source), strict=True)
    row, image = " ".join(texts[kind](value) for kind, value in values), source.images.get(defect.number)
    return row if image is None else f'{row} 1 Images 1 {{ {_quoted(image.file)} "TIFF" {image.page} "0" }}'


def _nm(um: float) -> int:
    return round(um * NM_PER_UM)


def _block(head: str, *lines: str) -> Iterator[str]:
    yield head
    yield "{"
    yield from (f"  {line}" for line in lines)
    yield "}"


def _field(name: str, *values: str | int) -> str:
    return f"Field {name} {len(values)} {{{', '.join(map(str, values))}}}"


def _list(name: str, columns: Sequence[str], rows: Sequence[str]) -> Iterator[str]:
    named = f"Columns {len(columns)} {{ {', '.join(columns)} }}"
    yield from _block(f"List {name}", named, *_block(f"Data {len(rows)}", *(f"{row} ;" for row in rows)))


_WRITERS = {"1.2": _flat_lines, "1.8": _nested_lines}
