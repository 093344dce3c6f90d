"""What the command line does without a session: surfaces made and read in its own process."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.evidence import FocusCurve
from wafer_viewer.model.recipe import Recipe
from wafer_viewer.model.surface import Mosaic
from wafer_viewer.session.evidence import focus_curve
from wafer_viewer.session.library import ENDING, today
from wafer_viewer.session.state import SurfaceInfo
from wafer_viewer.session.summary import summarise
from wafer_viewer.session.tasks import reconstruct_field, stitch_fields
from wafer_viewer.store.dataset import Dataset
from wafer_viewer.store.importers import open_stack
from wafer_viewer.store.lock import Lock
from wafer_viewer.store.npz import read_npz

Tell = Callable[[float], None]
READ_SHARE = 0.3
"""Of a reconstruction of image files, how much of the progress bar reading them takes."""


def surface_of(
    src: Sequence[Path], recipe: Recipe, z_step_um: float | None, pixel_um: float | None, result: str, tell: Tell
) -> tuple[Mosaic, SurfaceInfo]:
    """The surface of images or of a dataset, made now, and its numbers. Raises DatasetError for unreadable images."""
    if len(src) == 1 and is_dataset(src[0]):
        info = make_surface(src[0], recipe, result, again=False, tell=tell)
        return Dataset.open(src[0]).result(result).mosaic(), info
    from wafer_viewer.reconstruct.field import reconstruct

    files = src[0] if len(src) == 1 else tuple(src)
    stack = open_stack(files, z_step_um, pixel_um, progress=lambda share: tell(READ_SHARE * share))
    surface = reconstruct(stack, recipe, lambda share: tell(READ_SHARE + (1 - READ_SHARE) * share))
    return surface, summarise(surface, (surface,), result, recipe)


def make_surface(path: Path, recipe: Recipe, result: str, *, again: bool, tell: Tell) -> SurfaceInfo:
    """Heights of all fields that have none by this recipe yet, then the mosaic; the dataset is held meanwhile."""
    data = Dataset.open(path)
    lock = Lock.take(path)
    try:
        todo = _fields_to_do(data, recipe, result, again)
        steps = len(todo) + 1
        for i, number in enumerate(todo):
            reconstruct_field(path, number, result, recipe, None, progress=partial(_part, tell, i, steps))
        return stitch_fields(path, result, recipe, progress=partial(_part, tell, len(todo), steps))
    finally:
        lock.release()


def measured_surface(src: Path, field_number: int, result: str) -> tuple[Mosaic, bool]:
    """The surface of a dataset (0: the mosaic) or of a file, and whether its calibration holds today."""
    if not is_dataset(src):
        surface = read_npz(src)
        calibration = surface.provenance.calibration
        return surface, calibration is not None and calibration.problem(calibration.setup, today()) is None
    data = Dataset.open(src)
    kept = data.result(result)
    surface = kept.surface(data.field(field_number)) if field_number else kept.mosaic()
    return surface, data.calibration_problem(today()) is None


def evidence_of(
    src: Sequence[Path],
    at_um: tuple[float, float],
    field_number: int,
    result: str,
    recipe: Recipe,
    z_step_um: float | None,
    pixel_um: float | None,
    tell: Tell,
) -> FocusCurve:
    """Why a pixel of images or of a dataset has its height. The default recipe gives way to that of a surface.

    Raises DatasetError for what cannot be read, and for a surface without its frames.
    """
    if len(src) == 1 and is_dataset(src[0]):
        return focus_curve(src[0], result, field_number, *at_um, None if recipe == Recipe() else recipe)
    if src[0].suffix == ".npz":
        raise DatasetError(f"{src[0].name} is a surface without its frames: give the dataset or images it was made of.")
    from wafer_viewer.reconstruct import why

    stack = open_stack(src[0] if len(src) == 1 else tuple(src), z_step_um, pixel_um, progress=tell)
    return why.focus_curve(stack, *at_um, recipe)


def is_dataset(path: Path) -> bool:
    """Whether a path names a dataset, there or not."""
    return path.suffix == ENDING


def _fields_to_do(data: Dataset, recipe: Recipe, result: str, again: bool) -> list[int]:
    kept, complete = data.result(result), sorted(data.complete_fields())
    if not complete:
        raise DatasetError(f"{data.path.name} has no field with all its frames yet: go on with its scan.")
    same = kept.exists and kept.surfaces_done(data.fields) and kept.recipe() == recipe
    kept.save_recipe(recipe)
    done = kept.surfaces_done(data.fields) if same and not again else set[int]()
    return [number for number in complete if number not in done]


def _part(tell: Tell, index: int, total: int, share: float) -> None:
    tell((index + share) / total)
