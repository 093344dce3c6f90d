"""Panel of the step Acquire: time left, verdict, counters, latest frame."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import viser
from markupsafe import Markup
from numpy.typing import NDArray

from wafer_viewer.draw.number_format import duration, number, share, size, with_unit
from wafer_viewer.draw.surface.display_style import eight_bit
from wafer_viewer.gui.page.dialogs import Dialog
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.panels import VerdictSection, awaited, unfold
from wafer_viewer.gui.page.stop import NOT_STOPPED, stop
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callbacks import guarded
from wafer_viewer.gui.widgets.controls import HtmlBlock, button, command_button, in_a_row, leading, outlined, set_prop
from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.session.files.frame_check import damage_sentence
from wafer_viewer.session.state.snapshot import LatestFrame, OpenDataset, ScanProgress, Snapshot

RETAKE, NOT_RETAKEN = "Take damaged frames again…", "The frames were not taken again"
FRAME_EVERY_S = 0.18
FRAME_WIDTH_PX = 720


class AcquirePanel:
    """Progress, pause and stop, counters, latest frame; after the scan a button that shows the surface."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._frame_shown: LatestFrame | None = None
        self._frame_at = 0.0
        self._folder = page.gui.add_folder(None, visible=False)
        with self._folder:
            self._build()

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Update the panel."""
        set_prop(self._folder, "visible", view.step == "acquire")
        if view.step != "acquire":
            return
        scan = snapshot.scan
        running = snapshot.scanning
        self._title.show(html.title(*_title(snapshot)))
        self._figures.show(_figures(scan) if scan else "")
        set_prop(self._progress, "visible", scan is not None)
        set_prop(self._progress, "value", round(100 * _done(scan), 1) if scan else 0.0)
        self._show_buttons(snapshot, running)
        self._notes.show(self._page.notes(snapshot))
        self._verdict.show(snapshot)
        few = _few(snapshot, view)
        self._more.show(
            Markup('<div class="wv-more-of">{}</div>').format(unfold(more=not view.everything))
            if _released(snapshot)
            else Markup()
        )
        self._counters.show(_counters(scan) if scan and not few else "")
        self._show_frame(snapshot, few)

    def pause_or_resume(self) -> None:
        """Pause a running scan, or resume a paused one."""
        page = self._page
        if page.session.snapshot.rig.state == "paused":
            page.ask("The scan was not continued", page.session.resume())
        else:
            page.ask("The scan did not pause", page.session.pause())

    def _build(self) -> None:
        page, gui = self._page, self._page.gui
        self._title = HtmlBlock(gui)
        self._figures = HtmlBlock(gui)
        self._progress = gui.add_progress_bar(0.0)
        self._running = gui.add_folder(None, visible=False)
        with self._running:
            pause = guarded(page, "The scan did not pause")(lambda _: self.pause_or_resume())
            self._pause = command_button(gui, "Pause", viser.Icon.PLAYER_PAUSE, pause)
            halt = guarded(page, NOT_STOPPED)(lambda _: stop(page))
            self._stop = button(gui, "Stop scan", viser.Icon.PLAYER_STOP, halt)
            in_a_row(gui, [self._pause, self._stop], 40)
            HtmlBlock(
                gui, Markup('<div class="wv-why">Stop halts at once, in software: it is no emergency stop.</div>')
            )
        self._notes = HtmlBlock(gui)
        self._verdict = VerdictSection(page)
        self._more = HtmlBlock(gui)
        self._counters = HtmlBlock(gui)
        self._frame_head = HtmlBlock(gui)
        self._image = gui.add_image(np.zeros((3, 4, 3), np.uint8), format="jpeg", jpeg_quality=80, visible=False)
        self._frame_words = HtmlBlock(gui)
        self._why = HtmlBlock(gui)
        self._go_on = command_button(gui, "Continue the scan", viser.Icon.PLAYER_PLAY, self._continue())
        self._retake = command_button(gui, RETAKE, viser.Icon.REFRESH, guarded(page, NOT_RETAKEN)(self.retake))
        look = button(gui, "Look at the surface", viser.Icon.CUBE, lambda _: page.change(step="surface"))
        look_small = button(gui, "Look at the surface", viser.Icon.CUBE, lambda _: page.change(step="surface"))
        self._look, self._look_small = look, look_small
        self._next = command_button(gui, "Next wafer", viser.Icon.PLAYER_TRACK_NEXT, self._next_wafer())
        self._again = button(gui, "Scan it again", viser.Icon.REPEAT, lambda _: page.change(step="plan"))
        outlined(gui, look_small, 36)
        outlined(gui, self._again, 36)
        for handle in (self._go_on, self._retake, look, self._next):
            leading(gui, handle)

    def _continue(self) -> Callable[..., None]:
        page = self._page
        return guarded(page, "The scan was not continued")(
            lambda _: page.ask("The scan was not continued", page.session.continue_scan())
        )

    def retake(self, _: object = None) -> None:
        """Ask whether the sample lies on the stage as it did, and take the damaged frames again."""
        page, data = self._page, self._page.session.snapshot.dataset
        if data is None:
            return
        below = f"{damage_sentence(data.damaged)} {_sample(data)} must lie on the stage as it did for the scan."
        dialog = Dialog(page, "Take damaged frames again?", below)
        dialog.answers(
            "Take them again",
            viser.Icon.REFRESH,
            lambda: page.ask(NOT_RETAKEN, page.session.continue_scan(), lambda _: page.change(step="acquire")),
            NOT_RETAKEN,
        )

    def _next_wafer(self) -> Callable[..., None]:
        """Return the callback that prepares the same job for the next wafer and goes to Plan, for its id."""
        page, failed = self._page, "The next wafer was not prepared"
        return guarded(page, failed)(
            lambda _: page.ask(failed, page.session.jobs.next_wafer(), lambda _: page.change(step="plan"))
        )

    def _show_buttons(self, snapshot: Snapshot, running: bool) -> None:
        paused = snapshot.rig.state == "paused"
        set_prop(self._running, "visible", running)
        set_prop(self._pause, "label", "Continue" if paused else "Pause")
        set_prop(self._pause, "icon", viser.Icon.PLAYER_PLAY if paused else viser.Icon.PLAYER_PAUSE)
        set_prop(self._pause, "disabled", snapshot.rig.state == "stopping")
        set_prop(self._stop, "disabled", snapshot.rig.state == "stopping")
        data = snapshot.dataset
        unfinished = data is not None and not data.finished and not running
        damaged = _is_damaged(snapshot)
        why = _why_not(snapshot) if unfinished else why_not_retaken(snapshot) if damaged else None
        for handle, visible in ((self._go_on, unfinished), (self._retake, damaged)):
            set_prop(handle, "visible", visible)
            set_prop(handle, "disabled", why is not None)
        self._why.show(
            Markup('<div class="wv-why">Not yet: {}</div>').format(html.with_micro_sign(why)) if why else Markup()
        )
        done = not running and not unfinished and snapshot.surface is not None
        onward = done and _released(snapshot) and not awaited(snapshot) and not damaged
        set_prop(self._look, "visible", done and not onward and not damaged)
        set_prop(self._look_small, "visible", onward or (done and damaged))
        set_prop(self._next, "visible", onward)
        verdict = snapshot.operating.verdict
        set_prop(self._again, "visible", onward and verdict is not None and verdict.word == "inconclusive")

    def _show_frame(self, snapshot: Snapshot, few: bool) -> None:
        frame = self._page.session.latest_frame
        self._frame_head.show("" if few else _frame_head(frame))
        set_prop(self._image, "visible", frame is not None and not few)
        if few:
            self._frame_words.show("")
            return
        if frame is None:
            self._frame_words.show(html.empty("The latest frame will be shown here."))
            return
        self._frame_words.show(_frame_words(frame, snapshot))
        if frame is not self._frame_shown and time.monotonic() - self._frame_at > FRAME_EVERY_S:
            self._frame_shown, self._frame_at = frame, time.monotonic()
            self._image.image = picture(frame.image)


def _is_damaged(snapshot: Snapshot) -> bool:
    """Return whether frames of a finished scan were found damaged; those of an unfinished one are taken with it."""
    data = snapshot.dataset
    return data is not None and bool(data.damaged) and data.finished and not snapshot.scanning


def why_not_retaken(snapshot: Snapshot) -> str | None:
    """Return why damaged frames cannot be taken again now, or None."""
    data = snapshot.dataset
    if data is None or not data.damaged:
        return "no frame of the open dataset was found damaged: Check the frames looks at all."
    if not snapshot.is_of_this_rig:
        return "this rig did not take the dataset: restore the files from a copy."
    return _why_not(snapshot)


def _sample(data: OpenDataset) -> str:
    """Return the name of the sample of a dataset as the beginning of a sentence."""
    sample = data.job.sample
    names = [f"wafer {sample.wafer_id}" if sample.wafer_id else "", f"lot {sample.lot}" if sample.lot else ""]
    known = ", ".join(name for name in names if name)
    return f"{known[:1].upper()}{known[1:]}" if known else "The sample"


def _released(snapshot: Snapshot) -> bool:
    """Return whether the dataset belongs to a released job."""
    return snapshot.dataset is not None and snapshot.dataset.job.released


def _few(snapshot: Snapshot, view: View) -> bool:
    """Return whether only time left and verdict are shown."""
    return _released(snapshot) and not view.everything


def picture(image: Image) -> NDArray[np.uint8]:
    """Downsample a frame for display: uint8 [row, col, 3], at most `FRAME_WIDTH_PX` wide; 16 bit reduced to 8."""
    every = max(1, -(-image.shape[1] // FRAME_WIDTH_PX))
    small = image[::every, ::every]
    return np.repeat(eight_bit(small)[..., None], 3, axis=2)


def _why_not(snapshot: Snapshot) -> str | None:
    """Return why an unfinished scan cannot continue now, or None."""
    data, rig = snapshot.dataset, snapshot.rig
    if data is not None and data.read_only is not None:
        return data.read_only
    return None if rig.can_start else rig.message or f"the rig is {rig.state}."


def _title(snapshot: Snapshot) -> tuple[str, str]:
    scan, data = snapshot.scan, snapshot.dataset
    if snapshot.scanning and scan is not None:
        n = len(data.fields) if data else 0
        words = {"paused": "Paused at", "stopping": "Stopping at"}.get(snapshot.rig.state, "Scanning")
        return f"{words} field {scan.field.number}, {scan.order} of {n}", _how(scan, data)
    if snapshot.scanning:
        return "Starting the scan", "The stage moves to the first field."
    if data is not None and not data.finished:
        return "The scan is unfinished", _missing(data)
    if data is not None and data.damaged:
        return "Frames are damaged", damage_sentence(data.damaged)
    if scan is not None:
        return "The scan is done", _waits(snapshot) or _how(scan, data)
    return "No scan yet", "Start one in Plan."


def _how(scan: ScanProgress, data: OpenDataset | None) -> str:
    titles = {price.strategy: price.title for price in data.plan.prices} if data else {}
    return f"{titles.get(scan.strategy, scan.strategy)} · started {scan.started}" + (
        f" · took {duration(scan.seconds_gone)}" if scan.finished else ""
    )


def _missing(data: OpenDataset) -> str:
    remaining = sum(state.value in ("to come", "being taken", "to repeat") for state in data.states.values())
    return f"{remaining} of {len(data.fields)} fields are not complete; only the missing frames are taken."


def _waits(snapshot: Snapshot) -> str:
    if snapshot.surface is not None:
        return ""
    doing = " and ".join(work.title for work in snapshot.works)
    return f"Until the surface is there: {doing}." if doing else "The surface is being reconstructed."


def _done(scan: ScanProgress) -> float:
    return scan.frames_done / max(1, scan.frames_total)


def _figures(scan: ScanProgress) -> Markup:
    done = 100 * _done(scan)
    left = html.figure(
        "Took" if scan.finished else "Time left",
        duration(scan.seconds_gone if scan.finished else scan.seconds_left),
        size_px=46,
    )
    return html.columns([left, html.figure("Done", number(int(done), 0), "%", size_px=46)], "1.1fr 1fr") + Markup(
        '<div style="height:9px"></div>'
    )


def _counters(scan: ScanProgress) -> Markup:
    rate = scan.frames_done / scan.seconds_gone if scan.seconds_gone > 0 else None
    missing = html.figure(
        "Missing", number(scan.frames_missing, 0), size_px=19, tone="attention" if scan.frames_missing else None
    )
    cells = [
        html.figure("Pulses", number(scan.pulses, 0), size_px=19),
        html.figure("Frames", number(scan.frames_done, 0), size_px=19),
        html.figure("Of", number(scan.frames_total, 0), size_px=19),
        missing,
    ]
    return html.head("Counters", f"{number(rate, 1)} frames/s") + html.columns(cells)


def _frame_head(frame: LatestFrame | None) -> Markup:
    if frame is None:
        return html.head("Last frame")
    return html.head("Last frame", f"field {frame.field.number} · z {with_unit(frame.z_um, 1, signed=True)}")


def _frame_words(frame: LatestFrame, snapshot: Snapshot) -> Markup:
    limit = 65535 if frame.image.dtype == np.uint16 else 255
    rows = [
        ("Brightest pixel", f"{number(frame.brightest, 0)} of {number(limit, 0)}"),
        ("Pixels at the limit", share(frame.clipped_fraction, 2)),
    ]
    data, scan = snapshot.dataset, snapshot.scan
    if data is not None and scan is not None:
        total = data.plan.bytes_on_disk
        free = f" · {size(snapshot.draft.free_bytes)} free" if snapshot.draft.free_bytes is not None else ""
        if data.storage is not None:
            stored, saved = data.storage.stored_bytes, data.storage.saved_bytes
            rows.append(("Frames", f"{size(stored)} compressed · {size(saved)} saved"))
        rows.append(("Disk", f"{size(total * _done(scan))} of {size(total)}{free}"))
    return html.pairs(rows) + Markup('<div style="height:10px"></div>')
