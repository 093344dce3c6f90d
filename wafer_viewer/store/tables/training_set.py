"""Training set of judged defects: a folder of crops, and a table of features with both classifications.

The classes are those of the rules and of the reviewers. ``0007.npy`` holds the heights around defect 7 in um (float32,
NaN unmeasured), ``0007.png`` the all-in-focus image of the same pixels; ``features.csv`` has one line per defect,
``README.txt`` describes the columns.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.inspection.defect import Defect, Inspection, crop
from wafer_viewer.model.surface.height_map import HeightMap, Mosaic
from wafer_viewer.store.io.atomic_files import atomic_write, require_free
from wafer_viewer.store.tables.csv_tables import TableWriter

COLUMNS = (
    *("number", "heights", "picture", "class", "class by rules", "judgement", "judged by", "judged at", "die"),
    *("height_um", "mean_height_um", "major_um", "minor_um", "angle_deg", "area_um2", "volume_um3", "score"),
    *("confidence", "scale_px", "evidence", "pixel_um", "x0_um", "y0_um", "simulated"),
)
_README = """heights: NAME.npy, float32 [row, col], um, NaN where unmeasured; row 0 is the largest y.
picture: NAME.png, the all-in-focus picture of the same pixels.
class: the operator's word, or that of the rules where nobody gave one (judged by is empty then).
(x0_um, y0_um): stage place of the centre of pixel (0, 0); pixel_um its size.
"""


def write_training_set(inspection: Inspection, surface: Mosaic, folder: str | Path) -> Path:
    """Write the crops of all defects of an inspection to a new folder.

    Unmeasured areas are omitted.

    Parameters
    ----------
    inspection : Inspection
        Result of a defect inspection with at least one defect.
    surface : Mosaic
        Inspected surface, from which the crops are taken at full resolution.
    folder : str or Path
        Folder to write; it must not exist.

    Returns
    -------
    Path
        The folder written.

    Raises
    ------
    DatasetError
        When the folder exists, there is no defect, or the folder cannot be written.
    MeasureError
        When a defect lies outside the surface.

    Notes
    -----
    ``0007.npy`` holds the unsmoothed heights around defect 7 in um (float32 [row, col], NaN where unmeasured),
    ``0007.png`` the all-in-focus image of the same pixels; ``features.csv`` has one line per defect with the classes of
    the rules and of the reviewers, ``README.txt`` describes the columns. A crop is a square about the defect of twice
    its longer extent, at least 32 and at most 512 pixels, cut off at the border of the surface.
    """
    place = Path(folder)
    require_free(place)
    if not inspection.found:
        raise DatasetError("There are no defects to write a training set of.")
    with atomic_write(place) as temporary:
        temporary.mkdir()
        rows = [_write_one(temporary, surface, defect) for defect in inspection.found]
        (temporary / "features.csv").write_text(_table(rows), encoding="utf-8")
        (temporary / "README.txt").write_text(_README, encoding="utf-8")
    return place


def _write_one(folder: Path, surface: Mosaic, defect: Defect) -> list[object]:
    """Write the two files of a defect, and return its line of the table."""
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    cut = crop(surface, defect)
    name = f"{defect.number:04d}"
    np.save(folder / f"{name}.npy", np.asarray(cut.z_raw_um, np.float32))
    description = PngInfo()
    description.add_text("Description", f"{'SIMULATED. ' if defect.simulated else ''}All-in-focus image of a defect.")
    Image.fromarray(cut.all_in_focus).save(folder / f"{name}.png", pnginfo=description)
    return [*_names(defect, name), *_features(defect), *_lattice(cut), "SIMULATED" if defect.simulated else ""]


def _names(defect: Defect, name: str) -> Iterator[object]:
    yield from (defect.number, f"{name}.npy", f"{name}.png", defect.seen_as, defect.kind, defect.judgement)
    yield from (defect.judged_by, defect.judged_at, defect.die)


def _features(defect: Defect) -> Iterator[object]:
    lengths = (defect.height.value_um, defect.mean_height_um, defect.major.value_um, defect.minor.value_um)
    numbers = (*lengths, defect.angle_deg, defect.area.value, defect.volume.value, defect.score, defect.confidence)
    yield from (f"{number:.6g}" for number in (*numbers, defect.scale_px))
    yield defect.evidence


def _lattice(cut: HeightMap) -> Iterator[str]:
    yield from (f"{um:.6g}" for um in (cut.pixel_um, cut.x0_um, cut.y0_um))


def _table(rows: list[list[object]]) -> str:
    text = io.StringIO()
    table = TableWriter(text)
    table.writerow(COLUMNS)
    table.writerows(rows)
    return text.getvalue()
