"""The step Acquire: time left, verdict, counters, latest frame, and how to go on."""

from __future__ import annotations

from functools import partial

import numpy as np
import viser
from markupsafe import Markup
from numpy.typing import NDArray

from wafer_viewer.draw.number_format import duration, number, share, size, with_unit
from wafer_viewer.draw.surface.display_style import eight_bit
from wafer_viewer.gui.dialogs.dialog import Confirm, ask
from wafer_viewer.gui.dialogs.stop import NOT_STOPPED, stop
from wafer_viewer.gui.elements.elements import Button, Buttons, Elements, Html, Picture, Progress, Stack
from wafer_viewer.gui.elements.step import Here
from wafer_viewer.gui.page.browser_info import PHONE_PX
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.panels import awaited, unfold, verdict_html
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.session.files.frame_check import damage_sentence
from wafer_viewer.session.state.snapshot import LatestFrame, OpenDataset, ScanProgress, Snapshot

ICON = viser.Icon
RETAKE, NOT_RETAKEN = "Take damaged frames again…", "The frames were not taken again"
NOT_PAUSED, NOT_CONTINUED = "The scan did not pause", "The scan was not continued"
NOT_PREPARED = "The next wafer was not prepared"
FRAME_EVERY_S = 0.18
FRAME_WIDTH_PX = 720
_NO_EMERGENCY_STOP = Markup('<div class="wv-why">Stop halts at once, in software: it is no emergency stop.</div>')
_NEEDS_ROOM = Markup('<div class="wv-why">The other steps need a window at least {} px wide.</div>').format(PHONE_PX)


def acquire_step(here: Here[None]) -> Elements | None:
    """Return progress, pause and stop, counters and latest frame; after the scan the way to the surface."""
    snapshot, view, scan = here.snapshot, here.view, here.snapshot.scan
    if view.step != "acquire":
        return None
    few = _released(snapshot) and not view.everything
    more = Markup('<div class="wv-more-of">{}</div>').format(unfold(more=not view.everything))
    return [
        Html(html.title(*_title(snapshot))),
        Html(_figures(scan) if scan else ""),
        Progress(_done(scan)) if scan else None,
        Stack(_running(here)) if snapshot.scanning else None,
        Html(here.page.notes(snapshot)),
        Html(verdict_html(snapshot)),
        Html(more if _released(snapshot) else ""),
        Html(_counters(scan) if scan and not few else ""),
        Stack(_frame(snapshot, here.page.session.latest_frame)) if not few else None,
        Html(html.why_not(why_not_go_on(snapshot))),
        Stack(_onward(here)),
    ]


def pause_or_resume(page: Page) -> None:
    """Pause a running scan, or resume a paused one."""
    if page.session.snapshot.rig.state == "paused":
        page.ask(NOT_CONTINUED, page.session.resume())
    else:
        page.ask(NOT_PAUSED, page.session.pause())


def retake(page: Page) -> None:
    """Ask whether the sample lies on the stage as it did, and take the damaged frames again."""
    data = page.session.snapshot.dataset
    if data is None:
        return

    def again(_: object) -> None:
        page.ask(NOT_RETAKEN, page.session.continue_scan(), lambda _: page.change(step="acquire"))

    below = f"{damage_sentence(data.damaged)} {_sample(data)} must lie on the stage as it did for the scan."
    ask(page, "Take damaged frames again?", below, Confirm("Take them again", ICON.REFRESH, again, NOT_RETAKEN))


def why_not_retaken(snapshot: Snapshot) -> str | None:
    """Return why damaged frames cannot be taken again now, or None."""
    data = snapshot.dataset
    if data is None or not data.damaged:
        return "no frame of the open dataset was found damaged: Check the frames looks at all."
    if not snapshot.is_of_this_rig:
        return "this rig did not take the dataset: restore the files from a copy."
    return _why_not(snapshot)


def why_not_go_on(snapshot: Snapshot) -> str | None:
    """Return why a scan that lacks frames cannot go on now; None if it can, or lacks none."""
    if _unfinished(snapshot):
        return _why_not(snapshot)
    return why_not_retaken(snapshot) if _is_damaged(snapshot) else None


def picture(image: Image) -> NDArray[np.uint8]:
    """Downsample a frame for display: uint8 [row, col, 3], at most `FRAME_WIDTH_PX` wide; 16 bit reduced to 8."""
    every = max(1, -(-image.shape[1] // FRAME_WIDTH_PX))
    return np.repeat(eight_bit(image[::every, ::every])[..., None], 3, axis=2)


def _running(here: Here[None]) -> Elements:
    page, state = here.page, here.snapshot.rig.state
    label, icon = ("Continue", ICON.PLAYER_PLAY) if state == "paused" else ("Pause", ICON.PLAYER_PAUSE)
    ends = state == "stopping"
    pause = Button(label, partial(pause_or_resume, page), icon, disabled=ends, commands=True, failed=NOT_PAUSED)
    halt = Button("Stop scan", partial(stop, page), ICON.PLAYER_STOP, disabled=ends, failed=NOT_STOPPED)
    return [Buttons([pause, halt], 40), Html(_NO_EMERGENCY_STOP)]


def _frame(snapshot: Snapshot, frame: LatestFrame | None) -> Elements:
    if frame is None:
        return [Html(html.head("Last frame")), None, Html(html.empty("The latest frame will be shown here."))]
    head = html.head("Last frame", f"field {frame.field.number} · z {with_unit(frame.z_um, 1, signed=True)}")
    return [Html(head), Picture(frame.image, picture, FRAME_EVERY_S), Html(_frame_words(frame, snapshot))]


def _onward(here: Here[None]) -> Elements:
    """Return the buttons that go on: with what is missing, to the surface, or to the next wafer."""
    page, snapshot = here.page, here.snapshot
    off, unfinished, damaged = why_not_go_on(snapshot) is not None, _unfinished(snapshot), _is_damaged(snapshot)
    ends = not (snapshot.scanning or unfinished or page.watches_scan) and snapshot.surface is not None
    judged = ends and _released(snapshot) and not awaited(snapshot) and not damaged
    verdict = snapshot.operating.verdict
    doubtful = judged and verdict is not None and verdict.word == "inconclusive"
    look = partial(Button, "Look at the surface", partial(page.change, step="surface"), ICON.CUBE)
    lead = partial(Button, style="leading", commands=True)
    go_on = lead("Continue the scan", page.session.continue_scan, ICON.PLAYER_PLAY, disabled=off, failed=NOT_CONTINUED)
    following = lead("Next wafer", partial(_next_wafer, page), ICON.PLAYER_TRACK_NEXT, failed=NOT_PREPARED)
    return [
        go_on if unfinished else None,
        lead(RETAKE, partial(retake, page), ICON.REFRESH, disabled=off, failed=NOT_RETAKEN) if damaged else None,
        look("leading") if ends and not (judged or damaged) else None,
        look("outlined") if judged or (ends and damaged) else None,
        following if judged else None,
        Button("Scan it again", partial(page.change, step="plan"), ICON.REPEAT, "outlined") if doubtful else None,
        Html(_NEEDS_ROOM) if page.watches_scan and not snapshot.scanning else None,
    ]


def _next_wafer(page: Page) -> None:
    """Prepare the same job for the next wafer and go to Plan, for its id."""
    page.ask(NOT_PREPARED, page.session.jobs.next_wafer(), lambda _: page.change(step="plan"))


def _unfinished(snapshot: Snapshot) -> bool:
    data = snapshot.dataset
    return data is not None and not data.finished and not snapshot.scanning


def _is_damaged(snapshot: Snapshot) -> bool:
    """Return whether frames of a finished scan were found damaged; those of an unfinished one are taken with it."""
    data = snapshot.dataset
    return data is not None and bool(data.damaged) and data.finished and not snapshot.scanning


def _sample(data: OpenDataset) -> str:
    """Return the name of the sample of a dataset as the beginning of a sentence."""
    sample = data.job.sample
    names = [f"wafer {sample.wafer_id}" if sample.wafer_id else "", f"lot {sample.lot}" if sample.lot else ""]
    known = ", ".join(name for name in names if name)
    return f"{known[:1].upper()}{known[1:]}" if known else "The sample"


def _released(snapshot: Snapshot) -> bool:
    """Return whether the dataset belongs to a released job."""
    return snapshot.dataset is not None and snapshot.dataset.job.released


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
    return "No scan yet", "Scans are started in Plan."


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
