"""Dialogs of a calibration: its options before it runs, the signature that keeps its result, and the way to drop it."""

from __future__ import annotations

import viser
from markupsafe import Markup

from wafer_viewer.gui.page.dialogs import Dialog
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.presenters.calibration import SIMULATED, in_words, place
from wafer_viewer.gui.widgets.controls import HtmlBlock
from wafer_viewer.gui.widgets.number_field import OptionalNumber, option_label
from wafer_viewer.model.acquisition.characteristics import KINDS, CalibrationKind
from wafer_viewer.model.errors import RigError
from wafer_viewer.session.calibration.calibration_controller import FOCUS_RANGE_UM
from wafer_viewer.session.state.calibration_state import PendingCalibration

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
