"""Preconditions of commands: each returns a reason that follows "Not now:", or None."""

from __future__ import annotations

from wafer_viewer.gui.page.work_steps import TITLES, possible, why_not
from wafer_viewer.gui.presenters.review import chosen_defect, number_of
from wafer_viewer.gui.state.view_state import Step, View
from wafer_viewer.gui.widgets.controls import Obstacle
from wafer_viewer.model.measurement.sections import MOST_LINES
from wafer_viewer.session.state.snapshot import Snapshot


def can_undo(snapshot: Snapshot, view: View) -> bool:
    """Return whether a judgement can be undone."""
    of_defects = number_of(view.review) is not None
    return snapshot.inspection.can_undo if of_defects else snapshot.notebook.can_undo


def can_redo(snapshot: Snapshot, view: View) -> bool:
    """Return whether a judgement can be redone."""
    of_defects = number_of(view.review) is not None
    return snapshot.inspection.can_redo if of_defects else snapshot.notebook.can_redo


def no_dataset(snapshot: Snapshot, _: View) -> str | None:
    """Require an open dataset."""
    return None if snapshot.dataset is not None else "no dataset is open."


def no_frames(snapshot: Snapshot, view: View) -> str | None:
    """Require an open dataset with frames."""
    data = snapshot.dataset
    bare = "the open dataset is a surface without frames." if data is not None and not data.fields else None
    return no_dataset(snapshot, view) or bare


def no_surface(snapshot: Snapshot, view: View) -> str | None:
    """Require the stitched surface."""
    if snapshot.surface is not None:
        return None
    return no_dataset(snapshot, view) or "the surface is not stitched yet."


def surface_not_drawable(snapshot: Snapshot, view: View) -> str | None:
    """Require a drawable surface and a step other than Plan."""
    if not possible("surface", snapshot):
        return no_dataset(snapshot, view) or "no field has heights yet."
    return "the surface is not shown: go to Surface first." if view.step == "plan" else None


def no_fields_to_show(snapshot: Snapshot, view: View) -> str | None:
    """Require the step Surface with the stitched surface, over which fields and overlaps are drawn."""
    if (missing := require_step("surface")(snapshot, view)) is not None:
        return missing
    return None if view.show == 0 else "they are drawn over the stitched surface: show that first."


def surface_not_shown(snapshot: Snapshot, view: View) -> str | None:
    """Require that the view shows a surface."""
    missing = no_dataset(snapshot, view)
    return missing or (None if view.on_surface else "the surface is not shown: go to Surface first.")


def cannot_go_to(step: Step) -> Obstacle:
    """Return the precondition that `step` is available."""
    return lambda snapshot, _: why_not(step, snapshot)


def require_step(step: Step) -> Obstacle:
    """Return the precondition that `step` is the current step."""

    def why_not(snapshot: Snapshot, view: View) -> str | None:
        if view.step == step:
            return None
        return cannot_go_to(step)(snapshot, view) or f"go to {TITLES[step]} first."

    return why_not


def no_comparison(_: Snapshot, view: View) -> str | None:
    """Require that a comparison is shown."""
    return None if view.show < 0 else "no comparison is shown."


def no_defects(snapshot: Snapshot, view: View) -> str | None:
    """Require that the step Review is available."""
    return cannot_go_to("review")(snapshot, view)


def no_defect(snapshot: Snapshot, view: View) -> str | None:
    """Require a defect under review."""
    chosen = chosen_defect(snapshot, view.review) is not None
    return require_step("review")(snapshot, view) or (
        None if chosen else "no defect is under review: Page Down goes to one."
    )


def on_defect(_: Snapshot, view: View) -> bool:
    """Return whether a defect is under review, where Shift and the key of a judgement judge all alike."""
    return view.reviews_defect


def not_on_defect(_: Snapshot, view: View) -> bool:
    """Return whether no defect is under review, so that Shift and a letter or digit do what they do elsewhere."""
    return not view.reviews_defect


def nothing_inspected(snapshot: Snapshot, view: View) -> str | None:
    """Require the step Review and an inspection."""
    inspected = snapshot.inspection.inspection is not None
    return require_step("review")(snapshot, view) or (None if inspected else "the surface has not been inspected yet.")


def no_line(_: Snapshot, view: View) -> str | None:
    """Require a profile line in Measure."""
    shown = view.step == "measure" and view.tool == "profile" and view.lines
    return None if shown else "no profile is shown: key L adds a line."


def no_room_for_lines(snapshot: Snapshot, view: View) -> str | None:
    """Require a profile, with fewer than the maximum of lines."""
    full = f"there are {MOST_LINES} lines already, the most that share a plot."
    return no_line(snapshot, view) or (full if len(view.lines) >= MOST_LINES else None)


def no_corner(snapshot: Snapshot, view: View) -> str | None:
    """Require a profile along a polyline."""
    bent = view.active_line is not None and view.active_line.kind == "polyline"
    return no_line(snapshot, view) or (None if bent else "the line is straight.")


def no_other_line(snapshot: Snapshot, view: View) -> str | None:
    """Require at least two profile lines."""
    return no_line(snapshot, view) or (None if len(view.lines) > 1 else "there is no other line.")


def no_result(snapshot: Snapshot, view: View) -> str | None:
    """Require the step Measure and a selected result."""
    chosen = any(finding.number == view.selected for finding in snapshot.findings)
    return require_step("measure")(snapshot, view) or (
        None if chosen else "no result is chosen: click one in the list."
    )


def nothing_to_undo(snapshot: Snapshot, view: View) -> str | None:
    """Require a change to undo in the current step."""
    undoable = {"plan": snapshot.draft.can_undo, "acquire": snapshot.draft.can_undo, "measure": snapshot.findings_undo}
    return None if undoable.get(view.step, can_undo(snapshot, view)) else f"nothing was changed in {TITLES[view.step]}."


def nothing_to_redo(snapshot: Snapshot, view: View) -> str | None:
    """Require a change to redo in the current step."""
    redoable = {"plan": snapshot.draft.can_redo, "acquire": snapshot.draft.can_redo, "measure": snapshot.findings_redo}
    return None if redoable.get(view.step, can_redo(snapshot, view)) else f"nothing was undone in {TITLES[view.step]}."
