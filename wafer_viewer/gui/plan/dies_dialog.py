"""Dialog for the positions of dies on a wafer, over which features are repeated."""

from __future__ import annotations

from collections.abc import Iterator

import viser

from wafer_viewer.gui.page.dialogs import Dialog
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.plan.job_dialogs import edit, required_job
from wafer_viewer.gui.widgets.number_field import OptionalPair, Pair
from wafer_viewer.model.acquisition.devices import Overview
from wafer_viewer.model.errors import PlanError
from wafer_viewer.model.job.job import Job
from wafer_viewer.model.measurement.feature import Die, Dies, on_die
from wafer_viewer.model.region import Region

HOW = "A lattice in wafer µm, by the lower left corner of its first die. Those that lie within the fields are kept."


def dies_dialog(page: Page) -> None:
    """Open the dialog that defines the lattice of dies; dies outside of the scanned fields are dropped."""
    job = required_job(page)
    start = lattice_of(job.dies) if job.dies is not None else suggested_dies(page.session.snapshot.overview)
    dialog, gui = Dialog(page, "Dies", HOW), page.gui
    with dialog.modal:
        pitch = OptionalPair(gui, "Pitch, µm", _given(start.pitch_x_um, start.pitch_y_um), over=0)
        size = OptionalPair(gui, "Die, µm", _given(start.width_um, start.height_um), over=0)
        first = gui.add_vector2("First die, µm", (start.x0_um, start.y0_um), step=1.0)
        counts = gui.add_vector2("Across, up", (start.cols, start.rows), min=(1, 1), step=1)

    def keep() -> None:
        steps, sides = pitch.value, size.value or pitch.value
        if sides is None:
            raise PlanError("Die and pitch are not given: type at least one of them, such as 300 × 200.")
        if steps is None and counts.value != (1, 1):
            raise PlanError("The pitch of the dies is not given: type it, or 1 across and 1 up for a single die.")
        lattice = Dies(
            width_um=sides[0],
            height_um=sides[1],
            rows=int(counts.value[1]),
            cols=int(counts.value[0]),
            pitch_x_um=steps[0] if steps is not None else 0.0,
            pitch_y_um=steps[1] if steps is not None else 0.0,
            x0_um=first.value[0],
            y0_um=first.value[1],
        )
        edit(page, dies=within_fields(lattice, required_job(page)))

    dialog.answers("Keep", viser.Icon.CHECK, keep, "The dies were not changed")


def _given(x_um: float, y_um: float) -> Pair | None:
    """Return a pair for the input; a 0 (single row or column) takes the other value; None if both are 0."""
    return (x_um or y_um, y_um or x_um) if x_um or y_um else None


def within_fields(lattice: Dies, job: Job) -> Dies:
    """Return the dies of a lattice whose corners and centre lie within fields. Raises PlanError if there are none."""
    if job.grid is None:
        return lattice
    fields = [_box(f.x_um, f.y_um, job.grid.field_width_um, job.grid.field_height_um) for f in job.grid.fields()]
    seen = tuple(die for die in lattice.all() if all(_in_any(x, y, fields) for x, y in _places(die, lattice)))
    if not seen:
        raise PlanError(
            "No die of this lattice lies within the fields of the plan: correct the lattice, or add fields."
        )
    return Dies(width_um=lattice.width_um, height_um=lattice.height_um, listed=seen)


def lattice_of(dies: Dies) -> Dies:
    """Return dies as a lattice: as entered, or derived from the listed dies."""
    return dies if not dies.listed else _lattice([(d.x_um, d.y_um) for d in dies.listed], dies.width_um, dies.height_um)


def suggested_dies(overview: Overview | None) -> Dies:
    """Return the lattice of the dies in the overview; a single die of zero size if there are none."""
    boxes = [Region.polygon(*die).bounds_um for die in (overview.dies_um if overview is not None else ())]
    if not boxes:
        return Dies(width_um=0.0, height_um=0.0, rows=1, cols=1)
    x0, y0, x1, y1 = boxes[0]
    return _lattice([box[:2] for box in boxes], x1 - x0, y1 - y0)


def relative_to_die(places: tuple[Region, ...], dies: Dies) -> tuple[Region, ...]:
    """Return regions in wafer µm relative to the corner of their die. Raises PlanError if they lie on no die."""
    boxes = [place.bounds_um for place in places]
    x_um = (min(box[0] for box in boxes) + max(box[2] for box in boxes)) / 2
    y_um = (min(box[1] for box in boxes) + max(box[3] for box in boxes)) / 2
    for die in dies.all():
        if 0 <= x_um - die.x_um <= dies.width_um and 0 <= y_um - die.y_um <= dies.height_um:
            back = Die(name=die.name, x_um=-die.x_um, y_um=-die.y_um)
            return tuple(on_die(place, back) for place in places)
    raise PlanError("The places lie on no die: choose a result that was measured on one, or correct the dies.")


def _lattice(corners: list[tuple[float, float]], width_um: float, height_um: float) -> Dies:
    xs, ys = (sorted({round(corner[k], 1) for corner in corners}) for k in (0, 1))
    pitch_x, pitch_y = ((of[1] - of[0]) if len(of) > 1 else 0.0 for of in (xs, ys))
    return Dies(
        width_um=round(width_um, 1),
        height_um=round(height_um, 1),
        rows=len(ys),
        cols=len(xs),
        pitch_x_um=round(pitch_x, 1),
        pitch_y_um=round(pitch_y, 1),
        x0_um=xs[0],
        y0_um=ys[0],
    )


def _places(die: Die, lattice: Dies) -> Iterator[tuple[float, float]]:
    """Yield the corners of a die and its centre."""
    for across, up in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (0.5, 0.5)):
        yield die.x_um + across * lattice.width_um, die.y_um + up * lattice.height_um


def _box(x_um: float, y_um: float, width_um: float, height_um: float) -> tuple[float, float, float, float]:
    return x_um - width_um / 2, y_um - height_um / 2, x_um + width_um / 2, y_um + height_um / 2


def _in_any(x_um: float, y_um: float, boxes: list[tuple[float, float, float, float]]) -> bool:
    return any(x0 <= x_um <= x1 and y0 <= y_um <= y1 for x0, y0, x1, y1 in boxes)
