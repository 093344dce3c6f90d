"""Judgements in Review: one key judges an item and goes on, with Shift all alike; undo returns to it."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

import viser

from wafer_viewer.gui.dialogs.dialog import Confirm, ask_text
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.preconditions import no_defect, on_defect, require_step
from wafer_viewer.gui.presenters.results import Box
from wafer_viewer.gui.presenters.review import (
    JUDGED,
    JUDGEMENT_OF,
    ReviewItem,
    alike,
    chosen_defect,
    chosen_item,
    classes_of,
    first_changed,
    item_at,
    key_of,
    neighbour,
    number_of,
)
from wafer_viewer.gui.state.view_state import View, listed
from wafer_viewer.gui.widgets.controls import Command, with_precondition
from wafer_viewer.model.inspection.defect_classes import CLASS_KEYS, DEFECT_CLASSES, ClassTable
from wafer_viewer.model.inspection.learned_classes import NUISANCE
from wafer_viewer.model.job import Verdict
from wafer_viewer.model.spec import replace as with_fields
from wafer_viewer.session.state.snapshot import Snapshot

if TYPE_CHECKING:
    from wafer_viewer.gui.scenes.scene_view import SceneView

JUDGEMENTS: tuple[tuple[Verdict, str, str], ...] = (
    ("accepted", "Accept", "Real defect"),
    ("rejected", "Reject", "Not a defect"),
)
"""Verdict, and its button for results and for defects."""
NOT_JUDGED, NOT_NOTED = "The judgement was not saved", "The note was not changed"


ROUND_A_PLACE, LEAST_PX, ASPECT = 2.2, 160, 4 / 3
"""Size of the shown place as a multiple of the item's bounds, its least width in surface pixels, and its shape."""


def framed(item: ReviewItem, snapshot: Snapshot) -> Box:
    """Return the part of the surface to show for an item."""
    x0, y0, x1, y1 = item.box_um or (0.0, 0.0, 0.0, 0.0)
    least_um = LEAST_PX * (snapshot.surface.pixel_um if snapshot.surface else 1.0)
    width = max(ROUND_A_PLACE * max(x1 - x0, (y1 - y0) * ASPECT), least_um)
    x, y = (x0 + x1) / 2, (y0 + y1) / 2
    return x - width / 2, y - width / ASPECT / 2, x + width / 2, y + width / ASPECT / 2


class Review:
    """Commands of the step on one page."""

    def __init__(self, page: Page) -> None:
        self.page = page
        self._scene: SceneView | None = None

    def on_fly(self, scene: SceneView) -> None:
        """Set the scene whose camera is moved."""
        self._scene = scene

    def fly(self, box: Box | None) -> None:
        """Move the camera to a box, once its surface is drawn: another surface is framed anew."""
        if self._scene is not None and box is not None:
            self._scene.draw(self.page.session.snapshot, self.page.view)
            self._scene.fly_to(box)

    @property
    def item(self) -> ReviewItem | None:
        """Item under review; None in other steps."""
        page = self.page
        return chosen_item(page.session.snapshot, page.view) if page.view.step == "review" else None

    def judge(self, verdict: Verdict) -> None:
        """Judge the item and go on to the next."""
        if (item := self.item) is None:
            return
        if item.defect is None:
            self._begin(self.page.session.notebook.judge(item.key, verdict))
        else:
            self._begin(self.page.session.defects.judge(item.defect, JUDGEMENT_OF[verdict]))

    @property
    def classes(self) -> ClassTable:
        """Class table of the inspection."""
        return classes_of(self.page.session.snapshot.inspection)

    def on_key(self, key: str, act: Callable[[str], None]) -> None:
        """Pass the class that a key assigns to `act`; the page says so where none has this key."""
        entry = next((entry for entry in self.classes.offered if entry.key == key), None)
        if entry is None:
            self.page.say(f"No class has the key {key}", "The class table of the recipe gives the keys.")
        else:
            act(entry.name)

    def classify(self, kind: str) -> None:
        """Judge the defect as real, of a class, and go on to the next."""
        if (item := self.item) is not None and item.defect is not None:
            self._begin(self.page.session.defects.judge(item.defect, "real", kind))

    def as_learned(self) -> None:
        """Judge the defect as the judgements of others propose, and go on to the next."""
        page, item = self.page, self.item
        defect = chosen_defect(page.session.snapshot, item.key) if item is not None else None
        if defect is None or defect.learned is None:
            page.say("No class is proposed here from judgements", "Judge some defects, then press Propose classes.")
        elif defect.learned.kind == NUISANCE:
            self.judge("rejected")
        else:
            self.classify(defect.learned.kind)

    def judge_alike(self, verdict: Verdict, kind: str | None = None) -> None:
        """Judge the selected defects, else all open ones of the class under review, and go on."""
        page = self.page
        if not (numbers := alike(page.session.snapshot, page.view)):
            self.judge(verdict)
            return
        what = self.classes[kind].title.lower() if kind is not None else JUDGED[verdict]

        def go_on(_: Any) -> None:
            page.say(f"{len(numbers)} judged: {what}", "Ctrl + Z takes it back.")
            self.step(1)

        page.ask(NOT_JUDGED, page.session.defects.judge(numbers, JUDGEMENT_OF[verdict], kind), go_on)
        page.change(marked=())

    def reopen(self) -> None:
        """Take the judgement of the item away and stay."""
        if (item := self.item) is not None:
            judged = self.page.session.notebook.judge(item.key, "open") if item.defect is None else None
            self.page.ask(NOT_JUDGED, judged or self.page.session.defects.judge(item.defect or 0, "open"))

    def note(self, key: str, text: str) -> Future[Any]:
        """Save a note on an item."""
        number, session = number_of(key), self.page.session
        noted = session.notebook.judge(key, note=text) if number is None else session.defects.judge(number, note=text)
        self.page.ask(NOT_NOTED, noted)
        return noted

    def step(self, by: int) -> None:
        """Go to the next open item of the list, or to the previous one."""
        page = self.page
        if (item := neighbour(page.session.snapshot, page.view, by)) is not None and page.view.step == "review":
            self._look_at(item)

    def go_to(self, key: str) -> None:
        """Show one item."""
        page = self.page
        if (item := item_at(page.session.snapshot, key)) is not None:
            self._look_at(item)

    def list_by(self, **changes: Any) -> None:
        """Change order or filters; the review moves to the first open defect only if its own is filtered out."""
        page = self.page
        page.change(defects=with_fields(page.view.defects, **changes))
        now = listed(page.session.snapshot.inspection.defects, page.view.defects)
        if number_of(page.view.review) not in {defect.number for defect in now}:
            ahead = next((d for d in now if d.judgement == "open"), next(iter(now), None))
            if ahead is not None:
                self.go_to(key_of(ahead))

    def take_back(self, verb: Literal["undo", "redo"]) -> None:
        """Undo or redo a judgement, and return to what it was of."""
        page = self.page
        before, failed = page.session.snapshot, f"Nothing was {'undone' if verb == 'undo' else 'done again'}"
        store = page.session.notebook if number_of(page.view.review) is None else page.session.defects

        def go_back(_: Any) -> None:
            key = first_changed(before, page.session.snapshot)
            if key is not None and key != page.view.review:
                self.go_to(key)

        page.ask(failed, getattr(store, verb)(), go_back)

    def look(self, sheet: str) -> None:
        """Show another view over the scene, or the scene itself from near the item."""
        self.page.change(sheet=sheet)
        if sheet == "none" and (item := self.item) is not None:
            self.fly(framed(item, self.page.session.snapshot))

    def look_elsewhere(self) -> None:
        """Go from the pictures to the gallery, and from anything else to the pictures."""
        self.look("gallery" if self.page.view.sheet == "beside" else "beside")

    def ask_note(self) -> None:
        """Open the note dialog; Enter saves the note."""
        if (item := self.item) is None:
            return
        saves = Confirm("Save the note", viser.Icon.NOTE, lambda here: self.note(item.key, here.own), NOT_NOTED)
        title, below = f"Note on {item.sign} · {item.title}", "Saved with the judgement and shown in the report."
        ask_text(self.page, title, below, ("Note", item.judgement.note, "Enter saves, Escape cancels"), saves)

    def _begin(self, judged: Future[Any]) -> None:
        """Follow a judgement and go on at once: keys may come faster than judgements are kept."""
        self.page.ask(NOT_JUDGED, judged)
        self.step(1)

    def _look_at(self, item: ReviewItem) -> None:
        """Show the item with its surface and levelling, and move the camera to it where the scene is seen."""
        page, view = self.page, self.page.view
        page.entered()  # what is typed is a note on the item that is left
        changes: dict[str, Any] = {"review": item.key, "selected": None, "why": None}
        if (item.show, item.levelling) != (view.show, view.levelling):
            changes |= {"show": item.show, "levelling": item.levelling, "range_um": None}
            changes |= {"frame_k": None, "slice_z_um": None}
        page.change(**changes)
        if page.view.sheet_over == "none" and item.box_um is not None:
            self.fly(framed(item, page.session.snapshot))


def review_commands(review: Review) -> list[Command]:
    """Return the keyboard commands: next, previous, judge, classify, note."""
    icon = viser.Icon

    def commands(
        name: str, key: str | None, sign: Any, act: Callable[[], None], alike: Callable[[], None]
    ) -> list[Command]:
        together = Command(f"{name}, all alike", key, alike, sign, "shift" if key else None, "Review", here=on_defect)
        return [Command(name, key, act, sign, group="Review"), together]

    verdicts: tuple[tuple[Verdict, str, str, Any], ...] = (
        ("accepted", "Accept", "Y", icon.CHECK),
        ("rejected", "Reject", "N", icon.X),
    )
    return with_precondition(
        require_step("review"),
        Command("Next under review", "pagedown", lambda: review.step(1), icon.ARROW_RIGHT, group="Review"),
        Command("Previous under review", "pageup", lambda: review.step(-1), icon.ARROW_LEFT, group="Review"),
        *(
            command
            for verdict, name, key, sign in verdicts
            for command in commands(
                name, key, sign, partial(review.judge, verdict), partial(review.judge_alike, verdict)
            )
        ),
        Command("Reopen", None, review.reopen, icon.ARROW_BACK_UP, group="Review"),
        Command("Note…", "enter", review.ask_note, icon.NOTE, "shift", group="Review"),
        *with_precondition(
            no_defect,
            Command("As proposed from judgements", "Y", review.as_learned, icon.BULB, "alt", "Review", here=on_defect),
            Command("Pictures or gallery", "Z", review.look_elsewhere, icon.LAYOUT_GRID, group="Review"),
            Command("Defects in 3D", None, partial(review.look, "none"), icon.CUBE, group="Review"),
            *(
                replace(command, here=_both(_with_built_in_classes, command.here))
                for kind, look in DEFECT_CLASSES.items()
                for command in commands(
                    f"Class: {look.title}",
                    look.key or None,
                    icon.TAG,
                    partial(review.classify, kind),
                    partial(review.judge_alike, "accepted", kind),
                )
            ),
            *(
                replace(command, here=_both(_with_own_classes, command.here), listed=False)
                for key in CLASS_KEYS[1:]
                for command in commands(
                    f"Class on key {key}",
                    key,
                    icon.TAG,
                    partial(review.on_key, key, review.classify),
                    partial(review.on_key, key, partial(review.judge_alike, "accepted")),
                )
            ),
        ),
    )


Condition = Callable[[Snapshot, View], bool]


def _both(first: Condition, second: Condition | None) -> Condition:
    return first if second is None else lambda snapshot, view: first(snapshot, view) and second(snapshot, view)


def _with_built_in_classes(snapshot: Snapshot, view: View) -> bool:
    return classes_of(snapshot.inspection) is DEFECT_CLASSES


def _with_own_classes(snapshot: Snapshot, view: View) -> bool:
    return classes_of(snapshot.inspection) is not DEFECT_CLASSES
