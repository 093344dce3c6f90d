"""Inspection recipes, golden dies and defect files, and the export of defects to other programs."""

from __future__ import annotations

import io
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace as with_changes
from pathlib import Path, PureWindowsPath
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from wafer_viewer.model.acquisition.focus_stack import Image as GreyImage
from wafer_viewer.model.acquisition.sample import Alignment
from wafer_viewer.model.errors import DatasetError, MeasureError, WaferViewerError
from wafer_viewer.model.inspection.defect import DefectRecipe, Inspection
from wafer_viewer.model.inspection.die_grid import DieGrid
from wafer_viewer.model.inspection.klarf import Klarf, KlarfExport, KlarfImage
from wafer_viewer.model.inspection.lot import SAME_PITCH, WaferComparison, WaferDefects
from wafer_viewer.model.progress import Progress, ShouldStop, never, silent
from wafer_viewer.model.spec import replace
from wafer_viewer.session.core.commands import command, observer_command
from wafer_viewer.session.state.inspection_state import SAME_PLACE_UM, DefectFilesState, OtherTool

if TYPE_CHECKING:
    from wafer_viewer.model.inspection.golden_die import GoldenHeader
    from wafer_viewer.session.core.background_work import BackgroundWork
    from wafer_viewer.session.core.command_queue import CommandQueue
    from wafer_viewer.session.core.dataset_library import Library
    from wafer_viewer.session.inspection.inspection_job import Wafer


# -------------------------------------------------------------------------------------------------------- klarf overlay


KlarfUnit = Literal["um", "nm", "mm"]


def overlay_klarf(
    path: Path,
    alignment: Alignment | None,
    inspection: Inspection | None,
    unit: KlarfUnit | None = None,
    within_um: float = SAME_PLACE_UM,
) -> OtherTool:
    """Return the defects of a file in the coordinates of a surface.

    Raises DatasetError for what `read_klarf` refuses, dies of another pitch, and a distance that is not positive.
    """
    from wafer_viewer.store.tables.klarf import read_klarf

    if within_um <= 0:
        raise DatasetError(f"The same place is within {within_um:g} um: give more than 0.")
    klarf = read_klarf(path, unit)
    grid, by = lattice_for(klarf, alignment, inspection, path.name, within_um)
    pictures, problems = _pictures(klarf, path.parent)
    return OtherTool(path.name, replace(klarf, notes=klarf.notes + problems), grid, by, within_um, pictures)


MOST_PICTURES, PICTURE_PX = 200, 96
"""Most images that are read of a KLARF, and their longer side in px."""


def _pictures(klarf: Klarf, folder: Path) -> tuple[dict[int, bytes], tuple[str, ...]]:
    """Return the first image of each defect as a small JPEG, and notes on those that cannot be read."""
    listed = [(defect.number, defect.images[0]) for defect in klarf.defects if defect.images]
    pictures: dict[int, bytes] = {}
    problems: list[str] = []
    for number, image in listed[:MOST_PICTURES]:
        try:
            pictures[number] = _small_jpeg(read_klarf_image(folder, image))
        except WaferViewerError as fault:
            problems.append(str(fault))
    more = len(problems) - 1
    notes = (problems[0] + (f" So it is of {more} more." if more else ""),) if problems else ()
    left_out = len(listed) - MOST_PICTURES
    return pictures, notes + ((f"Images of {left_out} more defects are not shown.",) if left_out > 0 else ())


def _small_jpeg(grey: GreyImage) -> bytes:
    from PIL import Image

    scaled = grey if grey.dtype == np.uint8 else (grey >> 8).astype(np.uint8)
    small, content = Image.fromarray(scaled), io.BytesIO()
    small.thumbnail((PICTURE_PX, PICTURE_PX))
    small.save(content, "JPEG", quality=85)
    return content.getvalue()


def read_klarf_image(folder: Path, image: KlarfImage) -> GreyImage:
    """Read the image of a defect, in grey [row, col], from the folder of its KLARF file.

    Raises DatasetError when it is not there, is no image, or has fewer pages.
    """
    from wafer_viewer.store.images.image_files import read_file, read_page

    name = PureWindowsPath(image.file).name  # of a path with either separator
    path = folder / name
    if not path.is_file():
        raise DatasetError(f"The image {name} is not next to its KLARF file: copy it there.")
    try:
        return read_page(path, image.page - 1, name) if path.suffix.lower() in (".tif", ".tiff") else read_file(path)
    except (WaferViewerError, KeyError) as fault:
        raise DatasetError(f"The image {name} cannot be read: save it as an image of 8 or 16 bits.") from fault


def compared(other: OtherTool, inspection: Inspection) -> dict[str, Any]:
    """Return the matched and unmatched defects of both inspections by number, as values to be printed."""
    found = inspection.found
    matched = other.matched(found)
    return {
        "file": other.name,
        "places": len(other.klarf.defects),
        "same_within_um": other.within_um,
        "dies": other.by,
        "matched": {str(their_number): our_number for their_number, our_number in sorted(matched.items())},
        "not_found_here": [defect.number for defect, _ in other.unmatched(found)],
        "images": {
            str(d.number): [f"{image.file}, page {image.page}" for image in d.images]
            for d in other.klarf.defects
            if d.images
        },
        "not_in_file": sorted({defect.number for defect in found} - set(matched.values())),
        "notes": list(other.klarf.notes),
        "simulated": other.klarf.simulated,
    }


def lattice_for(
    klarf: Klarf,
    alignment: Alignment | None,
    inspection: Inspection | None,
    name: str,
    within_um: float = SAME_PLACE_UM,
) -> tuple[DieGrid, str]:
    """Return the lattice that the positions of a KLARF file refer to, stage um, and a description of its source.

    With an inspection, its dies are used. They are numbered from the wafer's centre if both file and alignment give it;
    without an alignment by their numbers, or with the centre at the stage's zero if that matches more defects. Without
    dies, the file's own lattice about the wafer's centre is used. Raises DatasetError if the pitches differ.
    """
    if inspection is None or (grid := inspection.grid) is None:
        return _about_center(klarf, alignment), "its own dies about the wafer's centre"
    _require_pitch(klarf, grid, name)
    by_numbers = grid, "dies by their numbers"
    if not (klarf.center_x_um or klarf.center_y_um):
        return by_numbers
    if alignment is not None:
        return _by_center(klarf, alignment, grid), "dies by the wafer's centre"
    at_zero = _by_center(klarf, Alignment(), grid), "dies by the wafer's centre, taken to be at the stage's zero"
    return max(by_numbers, at_zero, key=lambda candidate: len(klarf.matched(inspection.found, within_um, candidate[0])))


def _by_center(klarf: Klarf, alignment: Alignment, grid: DieGrid) -> DieGrid:
    """Return the lattice with the die numbers of the file."""
    x_um, y_um = grid.corner(*_steps(klarf, alignment, grid))
    return replace(grid, x0_um=x_um, y0_um=y_um)


def _about_center(klarf: Klarf, alignment: Alignment | None) -> DieGrid:
    """Return the file's lattice, rotated and shifted by the wafer's alignment on the stage."""
    if alignment is None:
        return klarf.grid
    lattice = klarf.grid
    x_um, y_um = alignment.to_stage(lattice.x0_um, lattice.y0_um)
    return replace(lattice, x0_um=x_um, y0_um=y_um, angle_rad=-alignment.rotation_rad)


def _steps(klarf: Klarf, alignment: Alignment, grid: DieGrid) -> tuple[int, int]:
    """Return the columns and rows between die 0,0 of the file and die 0,0 of the lattice."""
    cols, rows, u_um, v_um = grid.to_die(*(np.asarray(um) for um in alignment.to_stage(0.0, 0.0)))
    x_um, y_um = float(cols) * grid.pitch_x_um + float(u_um), float(rows) * grid.pitch_y_um + float(v_um)
    return round((x_um - klarf.center_x_um) / grid.pitch_x_um), round((y_um - klarf.center_y_um) / grid.pitch_y_um)


def _require_pitch(klarf: Klarf, grid: DieGrid, name: str) -> None:
    pairs = ((klarf.pitch_x_um, grid.pitch_x_um), (klarf.pitch_y_um, grid.pitch_y_um))
    if any(abs(theirs / ours - 1) > SAME_PITCH for theirs, ours in pairs):
        raise DatasetError(
            f"{name} has dies {klarf.pitch_x_um:.6g} x {klarf.pitch_y_um:.6g} um apart and this surface "
            f"{grid.pitch_x_um:.6g} x {grid.pitch_y_um:.6g} um: it is of another product, or in another unit."
        )


# ----------------------------------------------------------------------------------------------------- inspection files


Handover = Literal["klarf", "klarf18", "e142", "sinf", "csv", "dies", "training"]


def write_klarf(wafer: Wafer, inspection: Inspection, path: Path) -> Path:
    """Write a KLARF 1.2 file."""
    from wafer_viewer.store.tables.klarf_writer import write_klarf

    return write_klarf(inspection, path, wafer.sample, wafer.stated, surface=wafer.surface)


def write_klarf18(wafer: Wafer, inspection: Inspection, path: Path) -> Path:
    """Write a KLARF 1.8 file."""
    from wafer_viewer.store.tables.klarf_writer import write_klarf

    return write_klarf(inspection, path, wafer.sample, wafer.stated, surface=wafer.surface, version="1.8")


def write_e142(wafer: Wafer, inspection: Inspection, path: Path) -> Path:
    """Write a wafer map as SEMI E142."""
    from wafer_viewer.store.tables.wafer_map import write_wafer_map

    return write_wafer_map(inspection, path, replace(wafer.sample, notch=wafer.stated.notch), format="e142")


def write_sinf(wafer: Wafer, inspection: Inspection, path: Path) -> Path:
    """Write a wafer map as SINF."""
    from wafer_viewer.store.tables.wafer_map import write_wafer_map

    return write_wafer_map(inspection, path, replace(wafer.sample, notch=wafer.stated.notch), format="sinf")


def write_csv(wafer: Wafer, inspection: Inspection, path: Path) -> Path:
    """Write a table for a spreadsheet."""
    from wafer_viewer.store.io.atomic_files import write_text
    from wafer_viewer.store.tables.csv_tables import defects_csv

    write_text(path, defects_csv(inspection))
    return path


def write_dies(wafer: Wafer, inspection: Inspection, path: Path) -> Path:
    """Write a table of the dies for a spreadsheet."""
    from wafer_viewer.store.io.atomic_files import write_text
    from wafer_viewer.store.tables.csv_tables import dies_csv

    write_text(path, dies_csv(inspection))
    return path


def write_training(wafer: Wafer, inspection: Inspection, path: Path) -> Path:
    """Write a folder of image crops with the classes assigned by the rules and by people."""
    from wafer_viewer.store.tables.training_set import write_training_set

    return write_training_set(inspection, wafer.surface, path)


WRITERS: dict[Handover, Callable[[Wafer, Inspection, Path], Path]] = {
    "klarf": write_klarf,
    "klarf18": write_klarf18,
    "e142": write_e142,
    "sinf": write_sinf,
    "csv": write_csv,
    "dies": write_dies,
    "training": write_training,
}


def hand_over(
    dataset: Path,
    result: str,
    kind: Handover,
    path: Path,
    stated: KlarfExport = KlarfExport(),
    *,
    progress: Progress = silent,
    should_stop: ShouldStop = never,
) -> Path:
    """Write the stored defects of a dataset to a file or a folder, with their current judgements.

    stated: data of a KLARF that the dataset lacks, or that differ from its own.

    Raises DatasetError if there are none, the format cannot hold them, or the path cannot be written to; for image
    crops also if the surface has changed since.
    """
    wafer, inspection = _inspected(dataset, result, same_surface=kind == "training" or stated.images)
    return WRITERS[kind](with_changes(wafer, stated=stated.over(wafer.stated)), inspection, path)


def keep_golden(
    dataset: Path,
    result: str,
    name: str,
    *,
    progress: Progress = silent,
    should_stop: ShouldStop = never,
) -> Path:
    """Store the typical die of an inspected surface as the next version of a golden die, next to the dataset.

    Raises DatasetError if this surface was not inspected, the name is invalid or another product's, or the folder
    cannot be written to; MeasureError if there are no dies, or too few of them.
    """
    from wafer_viewer.measure.defects.inspection import golden_of_surface
    from wafer_viewer.store.records.golden_dies import FOLDER, save_golden

    wafer, inspection = _inspected(dataset, result, same_surface=True)
    if inspection.grid is None:
        raise MeasureError("A golden die is made from dies and this inspection has none: inspect die to die first.")
    golden = golden_of_surface(
        wafer.surface, inspection.grid, inspection.recipe, product=inspection.product, made_of=dataset.stem
    )
    return save_golden(golden, dataset.parent / FOLDER / name)


def learn_classes(
    dataset: Path, result: str, *, progress: Progress = silent, should_stop: ShouldStop = never
) -> Inspection:
    """Propose classes for the open defects of a dataset; nothing of its inspection is stored.

    Its judged defects are kept next to the dataset, with those of the product's other wafers, if it has a product.

    Raises DatasetError if this surface was not inspected, or a file cannot be read or written; MeasureError with too
    few judged defects, or without scikit-learn.
    """
    from wafer_viewer.measure.defects.learned_classes import grown, judged_defects, of_others, with_proposals
    from wafer_viewer.store.records.inspection_records import read_judged, save_judged

    wafer, inspection = _inspected(dataset, result, same_surface=True)
    name = f"{dataset.stem}/{result}"
    others = of_others(read_judged(dataset.parent, inspection.product), name)
    own = judged_defects(inspection, wafer.surface, wafer=name)
    proposed = with_proposals(inspection, wafer.surface, grown((own, others)))
    if inspection.product:
        save_judged(dataset.parent, replace(own, defects=(*others.defects, *own.defects)))
    return proposed


def _inspected(dataset: Path, result: str, *, same_surface: bool) -> tuple[Wafer, Inspection]:
    """Return the surface and its inspection; same_surface: require that this very surface was inspected."""
    from wafer_viewer.session.inspection.inspection_job import mosaic_mark, wafer_of
    from wafer_viewer.store.dataset.dataset import Dataset

    wafer = wafer_of(dataset, result)
    if (inspection := wafer.before) is None:
        raise DatasetError(f"{dataset.stem} was not inspected for defects yet: inspect it first.")
    if same_surface and inspection.mark not in ("", mosaic_mark(Dataset.open(dataset).result(result))):
        raise DatasetError(f"The surface of {dataset.stem} was reconstructed since it was inspected: inspect it again.")
    return wafer, inspection


TITLES: dict[Handover, str] = {
    "klarf": "KLARF",
    "klarf18": "KLARF",
    "e142": "Wafer map",
    "sinf": "Wafer map",
    "csv": "Table of defects",
    "dies": "Table of dies",
    "training": "Training set",
}


class DefectFiles:
    """Controller of recipes, golden dies and defect files, ``session.defects.files``; commands return futures."""

    def __init__(self, command_queue: CommandQueue, library: Library, background: BackgroundWork, folder: Path) -> None:
        self._command_queue, self._library, self._background, self._folder = command_queue, library, background, folder

    def open(self) -> None:
        """Remove what was compared with the previous surface, and list recipes and golden dies again."""
        self.take_away.run()
        self.take_earlier_away.run()
        self.refresh.run()

    @command
    def refresh(self) -> None:
        """List recipes and golden dies again."""
        from wafer_viewer.store.records.golden_dies import FOLDER, every_golden
        from wafer_viewer.store.records.inspection_records import readable_recipes

        recipes, problems = readable_recipes(self._folder)
        golden = sorted(every_golden(self._folder / FOLDER), key=lambda header: header.name.casefold())
        self._put(recipes=recipes, golden=tuple(golden), problems=problems)

    @command.audited("Defect recipe saved")
    def save_recipe(self, recipe: DefectRecipe) -> Path:
        """Save a recipe under its product and name; an earlier one is replaced."""
        from wafer_viewer.store.records.inspection_records import save_defect_recipe

        path = save_defect_recipe(self._folder, recipe)
        self.refresh.run()
        return path

    @command
    def rename_recipe(self, recipe: DefectRecipe, name: str) -> None:
        """Rename a stored recipe."""
        from wafer_viewer.store.records.inspection_records import rename_defect_recipe

        rename_defect_recipe(self._folder, recipe, name)
        self.refresh.run()

    @command.audited("Defect recipe deleted")
    def delete_recipe(self, recipe: DefectRecipe) -> None:
        """Delete a stored recipe and its file."""
        from wafer_viewer.store.records.inspection_records import delete_defect_recipe

        delete_defect_recipe(self._folder, recipe)
        self.refresh.run()

    @command.audited("Golden die kept")
    def keep_golden(self, name: str) -> Future[Path]:
        """Store the typical die of the inspected surface as the next version of a name; no version is overwritten."""
        title, arguments = f"Golden die {name}", (*self._looked_at, name)
        return self._background.run(title, keep_golden, *arguments, ended=lambda _: self.refresh.run()).done

    @command
    def add_golden(self, path: Path) -> GoldenHeader:
        """Copy a golden die from a file, as the next version of its name; the future's result is its header.

        A golden die in the data folder is not copied.
        """
        from wafer_viewer.store.records.golden_dies import ENDING, FOLDER, header_of, open_golden, save_golden

        path, folder = Path(path), self._folder / FOLDER
        if path.absolute().parent == folder.absolute():
            header = header_of(path)
        else:
            golden = open_golden(path)
            name = golden.header.name or path.name.removesuffix(ENDING)
            header = header_of(save_golden(golden, folder / name))
        self.refresh.run()
        return header

    @observer_command
    def write(self, kind: Handover, path: Path, stated: KlarfExport = KlarfExport()) -> Future[Path]:
        """Write the defects with their judgements to a file, for ``training`` to a new folder."""
        out = Path(path).absolute()
        return self._background.run(f"{TITLES[kind]} {out.name}", hand_over, *self._looked_at, kind, out, stated).done

    @command
    def lay_over(self, path: Path, unit: KlarfUnit | None = None, within_um: float = SAME_PLACE_UM) -> OtherTool:
        """Overlay the defects of a KLARF file on the surface; lengths are um unless the file or `unit` says otherwise.

        within_um: maximum distance between positions of the same defect.
        """
        alignment, inspection = self._library.shown.job.alignment, self._command_queue.now.inspection.inspection
        other = overlay_klarf(Path(path), alignment, inspection, unit, within_um)
        self._put(other=other)
        return other

    @command
    def take_away(self) -> None:
        """Remove the overlay."""
        self._put(other=None)

    @command
    def take_earlier_away(self) -> None:
        """Remove the comparison with an earlier inspection."""
        self._put(earlier=None)

    @command
    def compare(self, path: Path) -> WaferComparison:
        """Compare the defects on show with an earlier inspection of the wafer: a NAME.wafer or a KLARF file."""
        from wafer_viewer.measure.defects.adders import adders
        from wafer_viewer.session.inspection.lot_files import read_wafer_defects

        if (inspection := self._command_queue.now.inspection.inspection) is None:
            raise DatasetError("There are no defects to compare yet: inspect the surface first.")
        job = self._library.shown.job
        now = WaferDefects.of(inspection, self._library.dataset.path.stem, job.sample, job.alignment)
        compared = adders(read_wafer_defects(path), now)
        self._put(earlier=compared)
        return compared

    @property
    def _looked_at(self) -> tuple[Path, str]:
        return self._library.dataset.path, self._library.result_name

    def _put(self, **changes: Any) -> None:
        defect_files: DefectFilesState = with_changes(self._command_queue.now.defect_files, **changes)
        if defect_files != self._command_queue.now.defect_files:
            self._command_queue.change(defect_files=defect_files)
