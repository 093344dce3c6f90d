"""Panel of the step Review: one item at a time with picture, numbers, judgement and note."""

from __future__ import annotations

import base64
from collections.abc import Callable
from concurrent.futures import Future
from typing import TYPE_CHECKING, Any, Literal

import viser
from markupsafe import Markup

from wafer_viewer.gui.page import preconditions as judgement
from wafer_viewer.gui.page.dialogs import Dialog
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.panels import awaited
from wafer_viewer.gui.page.preconditions import no_defect, require_step
from wafer_viewer.gui.presenters.defects import chosen_defect, classes
from wafer_viewer.gui.presenters.results import ReviewItem
from wafer_viewer.gui.presenters.review import chosen_item, neighbour, numbers, picture, progress, review_items
from wafer_viewer.gui.presenters.verdict import waiting
from wafer_viewer.gui.scenes.surface_scene import source_of
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callbacks import Debouncer, guarded
from wafer_viewer.gui.widgets.controls import (
    BoundInput,
    Command,
    HtmlBlock,
    ToggleGroup,
    button,
    command_button,
    controlled,
    in_a_row,
    leading,
    set_prop,
    with_precondition,
)
from wafer_viewer.model.inspection.defect_classes import DEFECT_CLASSES, DefectClass
from wafer_viewer.model.job import Verdict
from wafer_viewer.model.roles import Action
from wafer_viewer.session.rendering.render_request import RenderRequest
from wafer_viewer.session.state.snapshot import Snapshot

if TYPE_CHECKING:
    from wafer_viewer.gui.scenes.scene_view import SceneView


FAILED = "The note was not changed"


def note_dialog(page: Page, item: ReviewItem) -> None:
    """Open the note dialog; Enter saves the note."""
    dialog = Dialog(page, f"Note on {item.sign} · {item.title}", "Saved with the judgement and shown in the report.")
    with dialog.modal:
        text = page.gui.add_text("Note", item.judgement.note, hint="Enter saves, Escape cancels")
    dialog.answers(
        "Save the note",
        viser.Icon.NOTE,
        lambda: page.ask(FAILED, judgement.note(page.session, item.key, text.value)),
        FAILED,
    )


JUDGEMENTS: tuple[tuple[Verdict, str], ...] = (("accepted", "Accept"), ("rejected", "Reject"))
ROUND_A_PLACE, LEAST_PX = 2.2, 160
"""Picture size as a multiple of the item's bounds, and its least width in surface pixels."""
ASPECT, PICTURE_PX = 4 / 3, 480


class ReviewPanel:
    """Panel of the item under review; the left panel lists all items."""

    def __init__(self, page: Page, scene: SceneView) -> None:
        self._page, self._scene = page, scene
        self._pictures: dict[RenderRequest, Future[bytes]] = {}
        self._note_of = ""
        self._waiting = HtmlBlock(page.gui)
        self._folder = page.gui.add_folder(None, visible=False)
        with self._folder:
            self._build()
        self._edits = Debouncer(self._commit_note, guarded(page, "The note was not changed"))
        page.on_pick("review", self.go_to)
        page.on_pick("defect-class", self.classify)
        page.on_pick("review-filter", lambda key: page.change(review_filter=key))

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Update the panel."""
        visible = view.step == "review" and not view.explains
        item = chosen_item(snapshot, view.review, view.defects) if visible else None
        set_prop(self._folder, "visible", item is not None)
        waits = visible and item is None
        self._waiting.show(self._page.notes(snapshot) + _nothing_yet(snapshot) if waits else "")
        if item is None:
            return
        if item.defect is not None and view.review != item.key:
            self._page.change(review=item.key)
        self._title.show(html.title(f"{item.sign} · {item.title}", item.below))
        self._notes.show(self._page.notes(snapshot))
        self._picture.show(picture(item, self._painted(item, snapshot)))
        self._numbers.show(numbers(item))
        defect = chosen_defect(snapshot, item.key)
        self._classes.show(classes(defect) if defect is not None else "")
        self._judgement.show(item.judgement.verdict)
        self._done.show(progress(review_items(snapshot)))
        set_prop(self._undo, "disabled", not judgement.can_undo(snapshot, view))
        set_prop(self._redo, "disabled", not judgement.can_redo(snapshot, view))
        if not self._edits.under_way:
            self._note_of = item.key
            self._note.show(item.judgement.note)

    def commands(self) -> list[Command]:
        """Return the keyboard commands: next, previous, accept, reject, classify, note."""
        icon = viser.Icon
        return with_precondition(
            require_step("review"),
            Command("Next under review", "pagedown", lambda: self.step(1), icon.ARROW_RIGHT, group="Review"),
            Command("Previous under review", "pageup", lambda: self.step(-1), icon.ARROW_LEFT, group="Review"),
            Command("Accept", "Y", lambda: self.judge("accepted"), icon.CHECK, group="Review"),
            Command("Reject", "N", lambda: self.judge("rejected"), icon.X, group="Review"),
            Command("Note…", "enter", self.note, icon.NOTE, "shift", group="Review"),
            *_class_commands(self.classify),
        )

    def step(self, by: int) -> None:
        """Go to the next open item of the list, or to the previous one."""
        page, view = self._page, self._page.view
        if view.step != "review":
            return
        snapshot = page.session.snapshot
        now = chosen_item(snapshot, view.review, view.defects)
        item = neighbour(snapshot, now.key if now else None, by, view.review_filter, view.defects)
        if item is not None:
            self._look_at(item)

    def go_to(self, key: str) -> None:
        """Show one item."""
        item = chosen_item(self._page.session.snapshot, key)
        if item is not None:
            self._look_at(item)

    def judge(self, verdict: Verdict) -> None:
        """Accept or reject the item; the same verdict again reopens it."""
        page, item = self._page, self._chosen
        if item is not None:
            new: Verdict = "open" if item.judgement.verdict == verdict else verdict
            page.ask("The judgement was not saved", judgement.judge(page.session, item.key, new))

    def classify(self, kind: DefectClass) -> None:
        """Set the class of the defect."""
        page, item = self._page, self._chosen
        if item is not None and item.defect is not None:
            page.ask("The class was not changed", page.session.defects.judge(item.defect, kind=kind))

    def note(self) -> None:
        """Open the note dialog of the item."""
        item = self._chosen
        if item is not None:
            note_dialog(self._page, item)

    @property
    def _chosen(self) -> ReviewItem | None:
        view = self._page.view
        visible = view.step == "review"
        return chosen_item(self._page.session.snapshot, view.review, view.defects) if visible else None

    def _build(self) -> None:
        page, gui = self._page, self._page.gui
        self._title, self._notes, self._picture, self._numbers, self._classes = (HtmlBlock(gui) for _ in range(5))
        HtmlBlock(gui, html.head("Judgement", "keys Y and N"))
        self._judgement = ToggleGroup(
            gui, "Decision", JUDGEMENTS, guarded(page, "The judgement was not saved")(self.judge), "Finding judged"
        )
        note = controlled(
            gui.add_text("Note", "", hint="Saved with the judgement and shown in the report"), "Finding judged"
        )
        self._note: BoundInput[str] = BoundInput(note, lambda _: self._edits.made(), page, "The note was not changed")
        judged: Action = "Finding judged"
        back, forth = self._taking_back("undo"), self._taking_back("redo")
        self._undo = command_button(gui, "Undo", viser.Icon.ARROW_BACK_UP, back, action=judged)
        self._redo = command_button(gui, "Redo", viser.Icon.ARROW_FORWARD_UP, forth, action=judged)
        in_a_row(gui, [self._undo, self._redo], 30)
        self._done = HtmlBlock(gui)
        on = button(
            gui, "Next", viser.Icon.ARROW_RIGHT, guarded(page, "The item was not changed")(lambda _: self.step(1))
        )
        leading(gui, on)

    def _taking_back(self, verb: Literal["undo", "redo"]) -> Callable[[Any], Any]:
        page, failed = self._page, f"Nothing was {'undone' if verb == 'undo' else 'done again'}"
        taking = judgement.undo if verb == "undo" else judgement.redo
        return guarded(page, failed)(lambda _: page.ask(failed, taking(page.session, page.view)))

    def _look_at(self, item: ReviewItem) -> None:
        """Show the item with its surface and levelling, and move the camera to it."""
        page, view, snapshot = self._page, self._page.view, self._page.session.snapshot
        changes: dict[str, Any] = {"review": item.key, "selected": None, "why": None}
        if (item.show, item.levelling) != (view.show, view.levelling):
            changes |= {"show": item.show, "levelling": item.levelling, "range_um": None}
            changes |= {"frame_k": None, "slice_z_um": None}
        page.change(**changes)
        if item.box_um is not None:
            self._scene.draw(snapshot, page.view)  # before the camera moves: another surface is framed anew
            self._scene.fly_to(framed(item, snapshot))

    def _commit_note(self) -> Future[Any] | None:
        page = self._page
        answer = judgement.note(page.session, self._note_of, self._note.value)
        page.ask("The note was not changed", answer)
        return answer

    def _painted(self, item: ReviewItem, snapshot: Snapshot) -> str:
        """Return the picture as a data URL; empty until it is rendered, which redraws the page."""
        source = source_of(snapshot, item.show)
        if source is None or item.box_um is None:
            return ""
        request = RenderRequest(source, "picture", box_um=framed(item, snapshot), side_px=PICTURE_PX)
        future = self._pictures.get(request)
        if future is None or future.cancelled():
            future = self._pictures[request] = self._page.session.paint(request)
            future.add_done_callback(lambda _: self._page.redraw())
        data = future.result() if future.done() and future.exception() is None else b""
        return f"data:image/jpeg;base64,{base64.b64encode(data).decode()}" if data else ""


def _class_commands(classify: Callable[[DefectClass], None]) -> list[Command]:
    """Return one command with a key for each defect class."""
    return with_precondition(
        no_defect,
        *(
            Command(f"Class: {look.title}", look.key, lambda k=kind: classify(k), viser.Icon.TAG, group="Review")
            for kind, look in DEFECT_CLASSES.items()
        ),
    )


def _nothing_yet(snapshot: Snapshot) -> Markup:
    """Return the hint shown when nothing is under review."""
    if awaited(snapshot):
        return waiting(snapshot.operating.judging)
    inspected = snapshot.inspection.inspection is not None
    say = (
        "No defect was found, and no result is kept."
        if inspected
        else "Inspect for defects on the left, or keep a result."
    )
    return html.title("Review", "One item after the other, by keyboard alone.") + html.empty(say)


def framed(item: ReviewItem, snapshot: Snapshot) -> tuple[float, float, float, float]:
    """Return the part of the surface to show for an item, with the aspect ratio of its picture."""
    x0, y0, x1, y1 = item.box_um or (0.0, 0.0, 0.0, 0.0)
    least_um = LEAST_PX * (snapshot.surface.pixel_um if snapshot.surface else 1.0)
    width = max(ROUND_A_PLACE * max(x1 - x0, (y1 - y0) * ASPECT), least_um)
    x, y = (x0 + x1) / 2, (y0 + y1) / 2
    return x - width / 2, y - width / ASPECT / 2, x + width / 2, y + width / ASPECT / 2
