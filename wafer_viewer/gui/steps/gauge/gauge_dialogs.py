"""Dialogs of the gauge check: its certificate, its signature, and the correction of the z scale."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import date
from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.draw.number_format import number, with_unit
from wafer_viewer.gui.page.dialogs import SIGNED_S, Dialog, sign_dialog
from wafer_viewer.gui.page.file_dialog import FileList
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.presenters.verdict import LOOKS
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import HtmlBlock, duo
from wafer_viewer.gui.widgets.number_field import OptionalNumber
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.gauge import Certificate, GaugeCheck, ScaleCorrection

NO_CERTIFICATE, NOT_SIGNED = "The certificate was not loaded", "The check was not signed"
NOT_CORRECTED = "The z scale was not changed"


@dataclass(frozen=True, slots=True)
class _Form:
    """Input fields of a certificate."""

    serials: Any
    step: Any
    expanded: Any
    nominal: Any
    laboratory: Any
    number: Any
    issued: Any
    expires: Any


def certificate_dialog(page: Page) -> None:
    """Open the dialog that reads a certificate from a file or from input fields."""
    dialog = Dialog(page, "Certificate of the gauge blocks", "A TOML file such as assets/gauge/step.toml.")
    with dialog.modal:
        files = FileList(dialog, "certificate", rows=3)
        files.add_upload()
        HtmlBlock(page.gui, html.head("Or type it in"))
        form = _form(page, page.session.snapshot.gauge.certificate)

    def take() -> None:
        if not files.is_empty:
            page.session.gauge.load_certificate(files.path()).result(SIGNED_S)
        else:
            page.session.gauge.put_certificate(_typed(form)).result(SIGNED_S)

    dialog.answers("Use certificate", viser.Icon.CERTIFICATE, take, NO_CERTIFICATE)


def sign_check_dialog(page: Page, check: GaugeCheck) -> None:
    """Open the dialog that signs a check; it repeats verdict and error and asks for a name."""
    word, _, tone = LOOKS[check.verdict]
    below = "It is saved with the dataset and in the log of checks and cannot be changed."
    error, scans = with_unit(check.deviation.value_um, 3, signed=True), f"{check.n} scan{'' if check.n == 1 else 's'}"
    summary = Markup('<div style="padding:2px 0 8px"><b style="color:var(--{})">{}</b> · error {} · {}</div>')
    sign_dialog(
        Dialog(page, "Sign this check?", below),
        summary.format(tone, word, error, scans),
        ("Sign and save", viser.Icon.SIGNATURE),
        lambda name, _: page.session.gauge.sign(name),
        NOT_SIGNED,
        name=_operator(page),
        asks_why=False,
    )


def correct_dialog(page: Page, offered: ScaleCorrection) -> None:
    """Open the dialog that corrects the z scale; it shows the change and asks for a name and a reason."""
    below = "Scans from now on are taken with the new scale. Datasets and signed checks stay as they are."
    now = page.session.snapshot.rig.calibration
    pairs = [
        ("z scale now", number(now.z_scale, 6) if now is not None else "none"),
        ("z scale then", number(offered.calibration.z_scale, 6)),
        ("The checked step changes by", with_unit(offered.changes_um, 3, signed=True)),
        ("Set against then", offered.calibration.against),
    ]
    same = "These blocks can no longer check this scale, because it was set with them. Use others."
    sign_dialog(
        Dialog(page, "Correct the z scale?", below),
        html.pairs(pairs) + html.note("attention", same, offered.advice),
        ("Correct the z scale", viser.Icon.ARROWS_VERTICAL),
        page.session.gauge.correct_scale,
        NOT_CORRECTED,
        label="Done by",
        name=_operator(page),
    )


def _form(page: Page, previous: Certificate | None) -> _Form:
    gui, height = page.gui, previous.step if previous is not None else None
    certified_um, u_um = (height.value_um, height.expanded_um) if height is not None else (None, None)
    nominal_um = previous.step_nominal_um if previous is not None else None
    duo(gui)
    serials = gui.add_text("Blocks", " / ".join(previous.serials) if previous is not None else "")
    number = gui.add_text("Number", previous.number if previous is not None else "")
    duo(gui)
    step = OptionalNumber(gui, "Step, µm", certified_um, over=0, hint="The certified step")
    expanded = OptionalNumber(gui, "U (k = 2), µm", u_um, over=0)
    nominal = OptionalNumber(gui, "Nominal, µm", nominal_um, over=0, hint="What the step is called")
    laboratory = gui.add_text("Laboratory", previous.laboratory if previous is not None else "")
    duo(gui)
    issued = gui.add_text("Issued", previous.issued.isoformat() if previous is not None else "")
    expires = gui.add_text("Valid until", previous.expires.isoformat() if previous is not None else "")
    return _Form(serials, step, expanded, nominal, laboratory, number, issued, expires)


def _typed(form: _Form) -> Certificate:
    """Return the certificate entered in the form. Raises MeasureError for missing entries or invalid dates."""
    return Certificate(
        number=form.number.value.strip() or "typed in",
        laboratory=form.laboratory.value.strip() or "not named",
        issued=_day("issue", form.issued.value),
        expires=_day("expiry", form.expires.value),
        nominal_um=form.nominal.value or form.step.value,
        value_um=form.step.value,
        expanded_um=form.expanded.value,
        serial_numbers=tuple(part.strip() for part in form.serials.value.split("/") if part.strip()),
    )


def _day(event: str, text: str) -> date:
    try:
        return date.fromisoformat(text.strip())
    except ValueError as fault:
        raise MeasureError(f"The day of {event} {text.strip()!r} is not a date: write it as 2027-03-14.") from fault


def _operator(page: Page) -> str:
    data = page.session.snapshot.dataset
    sample = data.job.sample if data is not None else None
    return sample.operator if sample is not None else ""
