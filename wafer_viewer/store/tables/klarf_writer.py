"""KLARF 1.2 writer, the exchange format of inspection tools and yield systems.

Lengths in um. XREL and YREL are the centre of a defect relative to the lower left corner of its die, along the axes of
the lattice; SampleCenterLocation is the wafer centre relative to the lower left corner of die 0,0. HEIGHT, signed, is
an additional column that other readers ignore. The test plan contains only dies that were inspected completely or that
have defects: a die that was not or only partly scanned must not appear clean.
"""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime
from pathlib import Path

import numpy as np

from wafer_viewer.model.acquisition.sample import Sample
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.inspection.defect import Defect, Inspection
from wafer_viewer.model.inspection.die_grid import DieGrid, DieStatus
from wafer_viewer.model.inspection.klarf import BINS, CLASS_NUMBERS
from wafer_viewer.store.io.atomic_files import write_text

COLUMNS = (
    *("DEFECTID", "XREL", "YREL", "XINDEX", "YINDEX", "XSIZE", "YSIZE", "DEFECTAREA", "DSIZE", "CLASSNUMBER", "TEST"),
    *("CLUSTERNUMBER", "ROUGHBINNUMBER", "FINEBINNUMBER", "HEIGHT", "IMAGECOUNT", "IMAGELIST"),
)
MM2_PER_CM2, UM2_PER_MM2, STANDARD_MM = 100.0, 1e6, 300.0


def write_klarf(
    inspection: Inspection,
    path: str | Path,
    sample: Sample = Sample(),
    *,
    center_um: tuple[float, float] = (0.0, 0.0),
    at: datetime | None = None,
) -> Path:
    """Write the defects of an inspection to a KLARF 1.2 file.

    Parameters
    ----------
    inspection : Inspection
        Result of a defect inspection with a die grid. Unmeasured areas are not written.
    path : str or Path
        File to write; an existing file is replaced.
    sample : Sample, optional
        Identification of the wafer: lot, wafer id, slot, notch and size (300 mm if not given). Default: empty.
    center_um : tuple of float, default (0.0, 0.0)
        Stage position (x, y) of the wafer centre in um.
    at : datetime, optional
        Time stamp of the file. Default: now.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    DatasetError
        When the inspection has no die grid, or the file cannot be written.

    Notes
    -----
    Lengths are in um. XREL and YREL are the centre of a defect relative to the lower left corner of its die, along the
    axes of the lattice; SampleCenterLocation is the wafer centre relative to the lower left corner of die 0,0. HEIGHT,
    signed, is an additional column that other readers ignore. The test plan contains only dies that were inspected
    completely or that have defects: a die that was not or only partly scanned must not appear clean. ROUGHBINNUMBER is
    the judgement: 0 open, 1 real, 2 nuisance.
    """
    if inspection.grid is None:
        raise DatasetError("KLARF gives places by dies and this inspection has none: give their pitch, or write a CSV.")
    text = "\n".join(_lines(inspection, inspection.grid, sample, center_um, at or datetime.now()))
    write_text(Path(path), text + "\n")
    return Path(path)


def _lines(
    inspection: Inspection, grid: DieGrid, sample: Sample, center_um: tuple[float, float], at: datetime
) -> Iterator[str]:
    yield from _head(inspection, sample, at)
    yield from _lattice(grid, sample, center_um)
    yield from _classes()
    yield from _plan(inspection)
    yield from _defects(inspection, grid)
    yield from _summary(inspection)
    yield "EndOfFile;"


def _head(inspection: Inspection, sample: Sample, at: datetime) -> Iterator[str]:
    stamp = f"{at:%m-%d-%Y %H:%M:%S}"
    yield "FileVersion 1 2;"
    yield f"FileTimestamp {stamp};"
    yield (
        'InspectionStationID "Wafer Viewer" "SIMULATED" "0";'
        if inspection.simulated
        else ('InspectionStationID "Wafer Viewer" "shape from focus" "0";')
    )
    yield "SampleType WAFER;"
    yield f"ResultTimestamp {stamp};"
    yield f"LotID {_quoted(sample.lot)};"
    yield f"SampleSize 1 {_size_mm(sample):.0f};"
    yield f"DeviceID {_quoted(inspection.product or sample.product)};"
    yield f"SetupID {_quoted(inspection.recipe.name)} {stamp};"
    yield f"StepID {_quoted(inspection.reference)};"


def _lattice(grid: DieGrid, sample: Sample, center_um: tuple[float, float]) -> Iterator[str]:
    col, row, u, v = _in_die(grid, *center_um)
    yield "SampleOrientationMarkType NOTCH;"
    yield f"OrientationMarkLocation {'DOWN' if sample.notch == 'none' else sample.notch.upper()};"
    yield f"DiePitch {grid.pitch_x_um:.6f} {grid.pitch_y_um:.6f};"
    yield "DieOrigin 0.000000 0.000000;"
    yield f"WaferID {_quoted(sample.wafer_id or sample.name)};"
    yield f"Slot {sample.slot};"
    yield f"SampleCenterLocation {col * grid.pitch_x_um + u:.6f} {row * grid.pitch_y_um + v:.6f};"


def _in_die(grid: DieGrid, x_um: float, y_um: float) -> tuple[int, int, float, float]:
    """Return (col, row, u_um, v_um) of one stage position."""
    col, row, u, v = grid.to_die(np.asarray(x_um), np.asarray(y_um))
    return int(col), int(row), float(u), float(v)


def _classes() -> Iterator[str]:
    yield f"ClassLookup {len(CLASS_NUMBERS) + 1}"
    yield ' 0 "Unclassified"'
    *_, last = CLASS_NUMBERS
    yield from (f' {n} "{kind.capitalize()}"{";" if kind == last else ""}' for kind, n in CLASS_NUMBERS.items())


def _plan(inspection: Inspection) -> Iterator[str]:
    """Yield the inspected dies and their area."""
    dies = _looked_at(inspection)
    yield "InspectionTest 1;"
    yield f"SampleTestPlan {len(dies)}{'' if dies else ';'}"
    yield from (f" {die.col} {die.row}{';' if die is dies[-1] else ''}" for die in dies)
    yield "InspectedAreaOrigin 0.000000 0.000000;"
    yield f"AreaPerTest {inspection.inspected_mm2 * UM2_PER_MM2:.6e};"


def _defects(inspection: Inspection, grid: DieGrid) -> Iterator[str]:
    found = inspection.found
    yield f"DefectRecordSpec {len(COLUMNS)} {' '.join(COLUMNS)} ;"
    yield f"DefectList{'' if found else ';'}"
    yield from (f" {_record(defect, grid)}{';' if defect is found[-1] else ''}" for defect in found)


def _record(defect: Defect, grid: DieGrid) -> str:
    col, row, u, v = _in_die(grid, defect.center.x_um, defect.center.y_um)
    x0, y0, x1, y1 = defect.outline.bounds_um
    lengths = (x1 - x0, y1 - y0, defect.area.value, defect.major.value_um)
    parts = (
        f"{defect.number} {u:.3f} {v:.3f} {col} {row}",
        " ".join(f"{length:.3f}" for length in lengths),
        f"{CLASS_NUMBERS.get(defect.seen_as, 0)} 1 0 {BINS[defect.judgement]} 0",
        f"{defect.height.value_um:.3f} 0 0",
    )
    return " ".join(parts)


def _looked_at(inspection: Inspection) -> list[DieStatus]:
    """Return the dies whose defect state is known."""
    return [die for die in inspection.dies if die.defects or (die.state == "whole" and die.defects is not None)]


def _summary(inspection: Inspection) -> Iterator[str]:
    found, plan = inspection.found, _looked_at(inspection)
    area_cm2 = inspection.inspected_mm2 / MM2_PER_CM2
    density = len(found) / area_cm2 if area_cm2 else 0.0
    yield "SummarySpec 5 TESTNO NDEFECT DEFDENSITY NDIE NDEFDIE ;"
    yield "SummaryList"
    yield f" 1 {len(found)} {density:.4f} {len(plan)} {sum(bool(die.defects) for die in plan)};"


def _size_mm(sample: Sample) -> float:
    return max(sample.width_um or 0.0, sample.height_um or 0.0) / 1000 or STANDARD_MM


def _quoted(text: str) -> str:
    """Return a quoted text; double quotes in it become single ones, as KLARF cannot escape them."""
    return '"' + " ".join(text.replace('"', "'").split()) + '"'
