"""Calibrations of the instrument: list of the kinds, panel of the chosen one, and its history below the scene."""

from __future__ import annotations

import viser
from markupsafe import Markup

from wafer_viewer.gui.gauge.gauge_panel import at_foot
from wafer_viewer.gui.page.dialogs import Dialog
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.panels import BottomPanel
from wafer_viewer.gui.presenters import calibration as words
from wafer_viewer.gui.presenters.calibration import SIMULATED, in_words, place
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callbacks import guarded
from wafer_viewer.gui.widgets.controls import Command, HtmlBlock, add_html, command_button, in_a_row, leading, set_prop
from wafer_viewer.gui.widgets.number_field import OptionalNumber, option_label
from wafer_viewer.model.acquisition.characteristics import KINDS, CalibrationKind
from wafer_viewer.model.errors import RigError
from wafer_viewer.session.calibration.calibration_controller import FOCUS_RANGE_UM
from wafer_viewer.session.state.instrument_state import PendingCalibration
from wafer_viewer.session.state.snapshot import Snapshot

ICON = viser.Icon


class CalibrationList:
    """Kinds of calibration at the left; a click chooses one."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._cell = HtmlBlock(page.gui)
        page.on_pick("calibration-kind", lambda kind: page.change(calibration=kind))

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Update the list."""
        shown = words.kinds_list(snapshot.calibration, view.calibration) + words.not_measured()
        self._cell.show(shown if view.at_instrument else "")


class CalibrationDock:
    """History of the chosen kind below the scene."""

    def __init__(self, page: Page) -> None:
        self._panel = BottomPanel(page, "calibration")
        with self._panel.tab:
            self._plot = HtmlBlock(page.gui)

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Update the chart."""
        if self._panel.show(view):
            chart = words.history_chart(snapshot.calibration.history(view.calibration))
            self._plot.show(Markup('<div class="wv-below">{}</div>').format(chart))


class InstrumentPanel:
    """Panel of one kind of calibration: what runs, the result that waits, signed values, and what comes next."""

    def __init__(self, page: Page) -> None:
        self._page = page
        page.on_pick("gauge-look", lambda look: self._look(look == "instrument"))
        page.on_pick("calibration-live", lambda _: page.change(step="plan", live=True))
        self._folder = page.gui.add_folder(None, visible=False)
        with self._folder:
            self._build()

    def commands(self) -> list[Command]:
        """Return the commands of the instrument."""

        def in_gauge(_: Snapshot, view: View) -> bool:
            return view.step == "gauge"

        def here(_: Snapshot, view: View) -> bool:
            return view.at_instrument

        def no_result(snapshot: Snapshot, _: View) -> str | None:
            return None if snapshot.calibration.pending is not None else "no result waits."

        return [
            Command(
                "Gauge blocks or instrument",
                None,
                lambda: self._look(not self._page.view.instrument),
                ICON.MICROSCOPE,
                group="Gauge check",
                here=in_gauge,
            ),
            Command(
                "Run the calibration…",
                None,
                self._run,
                ICON.PLAYER_PLAY,
                group="Gauge check",
                here=here,
                why_not=lambda snapshot, view: words.why_not_run(snapshot, view.calibration),
            ),
            Command(
                "Keep the calibration…",
                None,
                self._keep,
                ICON.SIGNATURE,
                group="Gauge check",
                here=here,
                why_not=no_result,
            ),
            Command(
                "Discard the calibration…",
                None,
                self._discard,
                ICON.TRASH,
                group="Gauge check",
                here=here,
                why_not=no_result,
            ),
        ]

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Update the panel."""
        visible = view.at_instrument and not view.explains
        set_prop(self._folder, "visible", visible)
        if not visible:
            return
        state, kind = snapshot.calibration, view.calibration
        history, pending = state.history(kind), state.pending
        self._title.show(words.kind_title(kind) + words.next_due(state, kind))
        damaged = html.note("fault", "The calibrations were not read", state.problem) if state.problem else Markup()
        self._notes.show(self._page.notes(snapshot) + damaged)
        self._now.show(words.running(snapshot) + words.waiting(pending, state, kind))
        self._values.show(
            words.in_force(history) + words.history_table(history) + words.next_scans(snapshot.rig.calibration)
        )
        self._show_verbs(snapshot, view)

    def _build(self) -> None:
        gui = self._page.gui
        self._title, self._notes, self._now, self._values = (HtmlBlock(gui) for _ in range(4))
        self._why = HtmlBlock(gui)
        page = self._page
        self._drop = command_button(
            gui, "Discard…", ICON.TRASH, guarded(page, NOT_DISCARDED)(lambda _: self._discard())
        )
        in_a_row(gui, [self._drop], 34)
        add_html(gui, html.style_sheet(at_foot(self._drop)))
        self._leads = {
            "run": command_button(gui, "Run here…", ICON.PLAYER_PLAY, guarded(page, NOT_RUN)(lambda _: self._run())),
            "evaluate": command_button(
                gui, "Evaluate the checks", ICON.MATH_FUNCTION, guarded(page, NOT_RUN)(lambda _: self._run())
            ),
            "keep": command_button(
                gui,
                "Keep…",
                ICON.SIGNATURE,
                guarded(page, NOT_KEPT)(lambda _: self._keep()),
                action="Calibration accepted",
            ),
        }
        for handle in self._leads.values():
            leading(gui, handle)

    def _show_verbs(self, snapshot: Snapshot, view: View) -> None:
        pending = snapshot.calibration.pending
        own = pending is not None and pending.result.kind == view.calibration
        by_checks = KINDS[view.calibration].source == "gauge checks"
        lead = "keep" if own else "evaluate" if by_checks else "run"
        why = words.why_not_keep(snapshot) if own else words.why_not_run(snapshot, view.calibration)
        for name, handle in self._leads.items():
            set_prop(handle, "visible", name == lead)
        set_prop(self._leads[lead], "disabled", why is not None)
        set_prop(self._drop, "visible", own)
        foot = "" if own else " wv-at-foot"  # the button that discards is there
        line = Markup('<div class="wv-why{}">Not yet: {}</div>')
        self._why.show(line.format(foot, html.with_micro_sign(why)) if why else "")

    def _look(self, instrument: bool) -> None:
        self._page.change(instrument=instrument, why=None)
        if instrument:  # the command line may have added a record
            self._page.ask("The calibrations were not read", self._page.session.calibration.refresh())

    def _run(self) -> None:
        kind = self._page.view.calibration
        if KINDS[kind].source == "gauge checks":
            self._page.ask(NOT_RUN, self._page.session.calibration.run(kind))
        else:
            run_dialog(self._page, kind)

    def _keep(self) -> None:
        if (pending := self._page.session.snapshot.calibration.pending) is not None:
            keep_dialog(self._page, pending)

    def _discard(self) -> None:
        if (pending := self._page.session.snapshot.calibration.pending) is not None:
            discard_dialog(self._page, pending)


WAIT_S = 20.0
"""Timeout of the signature, which is awaited so that the dialog can show its error."""
NOT_RUN, NOT_KEPT, NOT_DISCARDED = "Calibration failed", "Nothing was kept", "The result was not discarded"


def run_dialog(page: Page, kind: CalibrationKind) -> None:
    """Open the dialog that runs a calibration at the present position of the stage, with its options."""
    one = KINDS[kind]
    below = f"{one.about} The stage moves: check that nothing is in the way."
    dialog = Dialog(page, f"Run here: {one.title}", below)
    gui, limits = page.gui, page.session.snapshot.rig.limits
    with dialog.modal:
        HtmlBlock(gui, place(page.session.snapshot.rig, one.needs))
        options = {
            option.name: OptionalNumber(
                gui,
                option_label(option),
                option.default,
                hint=option.about,
                least=1 if isinstance(option.default, int) else 0,
                integer=isinstance(option.default, int),
            )
            for option in one.options
        }
        focus_range = OptionalNumber(
            gui, "z range, µm", FOCUS_RANGE_UM, over=0, hint="Range about this z in which the focus is searched, µm"
        )
        camera = limits.camera if limits is not None else None
        exposure = OptionalNumber(
            gui,
            "Exposure, µs",
            hint="Of all frames; an empty field has it found",
            least=camera.exposure_min_us if camera is not None else None,
            most=camera.exposure_max_us if camera is not None else None,
        )

    def run() -> None:
        given = {name: field.value for name, field in options.items()}
        found = page.session.calibration.run(kind, focus_range.value or FOCUS_RANGE_UM, exposure.value, **given)
        page.ask(NOT_RUN, found)

    dialog.answers("Run here", viser.Icon.PLAYER_PLAY, run, NOT_RUN)


def keep_dialog(page: Page, pending: PendingCalibration) -> None:
    """Open the dialog that signs a result; it repeats the values and asks for a name and a reason."""
    below = "It is recorded for good, and the next scans use it. Datasets stay as they are."
    dialog = Dialog(page, f"Keep: {KINDS[pending.result.kind].title}?", below)
    with dialog.modal:
        words = in_words(pending.result.characteristics[0])
        simulated = SIMULATED if pending.simulated else Markup()
        HtmlBlock(page.gui, Markup('<div style="padding:2px 0 8px"><b>{}</b> {}</div>').format(words, simulated))
        name = page.gui.add_text("Signed by", page.browser.name)
        why = page.gui.add_text("Reason", "")

    def keep() -> None:
        if not name.value.strip():
            raise RigError("The signature is missing: type your name.")
        page.session.calibration.keep(name.value.strip(), why.value.strip()).result(WAIT_S)

    dialog.answers("Keep and sign", viser.Icon.SIGNATURE, keep, NOT_KEPT)


def discard_dialog(page: Page, pending: PendingCalibration) -> None:
    """Open the dialog that discards a result."""
    title = KINDS[pending.result.kind].title
    below = "Nothing is recorded, and the values in force stay. This cannot be undone."
    dialog = Dialog(page, f"Discard: {title}?", below)

    def discard() -> None:
        page.ask(NOT_DISCARDED, page.session.calibration.discard())

    dialog.answers("Discard the result", viser.Icon.TRASH, discard, NOT_DISCARDED)
