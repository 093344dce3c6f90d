"""Dialogs of the gauge check: its certificate, its signature, and the correction of the z scale."""

from __future__ import annotations

from datetime import date
from typing import Annotated

import viser
from markupsafe import Markup

from wafer_viewer.draw.number_format import number, plural, with_unit
from wafer_viewer.gui.dialogs.dialog import WAIT_S, Confirm, sign_dialog
from wafer_viewer.gui.dialogs.file_dialog import FileDialog
from wafer_viewer.gui.elements.elements import Elements, Html, Stack
from wafer_viewer.gui.elements.form import form
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.presenters.verdict import LOOKS
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.gauge import Certificate, GaugeCheck, ScaleCorrection
from wafer_viewer.model.spec import Positive, Setting, Spec

NO_CERTIFICATE, NOT_SIGNED = "The certificate was not loaded", "The check was not signed"
NOT_CORRECTED = "The z scale was not changed"


def _day(event: str) -> Setting:
    return Setting(event, "The last day, as 2027-03-14" if event == "Valid until" else "The day, as 2026-03-14")


class _Form(Spec, frozen=True, kw_only=True):
    """Certificate as it is typed."""

    serials: Annotated[str, Setting("Blocks", "Serial numbers of the blocks, / between them")] = ""
    number: Annotated[str, Setting("Number", "Of the certificate")] = ""
    step_um: Annotated[Positive | None, Setting("Step, µm", "The certified step")] = None
    expanded_um: Annotated[Positive | None, Setting("U (k = 2), µm", "Expanded uncertainty of the certified step")] = (
        None
    )
    nominal_um: Annotated[Positive | None, Setting("Nominal, µm", "Nominal value of the step")] = None
    laboratory: Annotated[str, Setting("Laboratory", "Laboratory that issued the certificate")] = ""
    issued: Annotated[str, _day("Issued")] = ""
    expires: Annotated[str, _day("Valid until")] = ""

    @classmethod
    def of(cls, old: Certificate | None) -> _Form:
        """Return the form of a certificate; an empty one without it."""
        if old is None:
            return cls()
        return cls(
            serials=" / ".join(old.serials),
            number=old.number,
            step_um=old.step.value_um,
            expanded_um=old.step.expanded_um,
            nominal_um=old.step_nominal_um,
            laboratory=old.laboratory,
            issued=old.issued.isoformat(),
            expires=old.expires.isoformat(),
        )

    def certificate(self) -> Certificate:
        """Return the certificate. Raises MeasureError for missing entries or invalid dates."""
        return Certificate(
            number=self.number.strip() or "typed in",
            laboratory=self.laboratory.strip() or "not named",
            issued=_date("issue", self.issued),
            expires=_date("expiry", self.expires),
            nominal_um=self.nominal_um or self.step_um,
            value_um=self.step_um,
            expanded_um=self.expanded_um,
            serial_numbers=self.named_blocks,
        )

    @property
    def named_blocks(self) -> tuple[str, ...]:
        """Serial numbers of the blocks."""
        return tuple(part.strip() for part in self.serials.split("/") if part.strip())


def certificate_dialog(page: Page) -> None:
    """Open the dialog that reads a certificate from a file or from input fields."""

    def contents(here: FileDialog[_Form]) -> Elements:
        def row(*names: str) -> Stack:
            return Stack(form(here.own, here.put, *names), side_by_side=True)

        return [
            *here.files(),
            here.upload(),
            Html(html.head("Or type it in", "Of a DCC: what it leaves open")),
            row("serials", "number"),
            row("step_um", "expanded_um"),
            *form(here.own, here.put, "nominal_um", "laboratory"),
            row("issued", "expires"),
        ]

    def take(here: FileDialog[_Form]) -> None:
        if here.is_empty:
            page.session.gauge.put_certificate(here.own.certificate()).result(WAIT_S)
        else:
            typed = here.own  # what still stands there of the certificate before is none of the new file
            expires = _date("expiry", typed.expires) if typed.expires not in ("", own.expires) else None
            named = typed.named_blocks if typed.serials != own.serials else ()
            page.session.gauge.load_certificate(here.path(), expires, named).result(WAIT_S)

    title = "Certificate of the gauge blocks"
    below = "A DCC of the laboratory (.xml), or a TOML file such as assets/gauge/step.toml."
    answer = Confirm("Use certificate", viser.Icon.CERTIFICATE, take, NO_CERTIFICATE)
    own = _Form.of(page.session.snapshot.gauge.certificate)
    FileDialog(page, title, below, answer, "certificate", own, contents, rows=3)


def sign_check_dialog(page: Page, check: GaugeCheck) -> None:
    """Open the dialog that signs a check; it repeats verdict and error and asks for a name."""
    word, _, tone = LOOKS[check.verdict]
    below = "It is saved with the dataset and in the log of checks and cannot be changed."
    error, scans = with_unit(check.deviation.value_um, 3, signed=True), plural(check.n, "scan")
    summary = Markup('<div style="padding:2px 0 8px"><b style="color:var(--{})">{}</b> · error {} · {}</div>')
    sign_dialog(
        page,
        "Sign this check?",
        below,
        summary.format(tone, word, error, scans),
        ("Sign and save", viser.Icon.SIGNATURE),
        lambda name, _: page.session.gauge.sign(name),
        NOT_SIGNED,
        signer=("Signed by", "Who signs the check; recorded in the log and in reports"),
        name=_operator(page),
        asks_why=False,
    )


def correct_dialog(page: Page, offered: ScaleCorrection) -> None:
    """Open the dialog that corrects the z scale; it shows the change and asks for a name and a reason."""
    below = "Scans from now on are taken with the new scale. Datasets and signed checks stay as they are."
    now = page.session.snapshot.rig.calibration
    pairs = [
        ("z scale now", number(now.z_scale, 6) if now is not None else "none"),
        ("z scale after", number(offered.calibration.z_scale, 6)),
        ("The checked step changes by", with_unit(offered.changes_um, 3, signed=True)),
        ("Then set against", offered.calibration.against),
    ]
    same = "These blocks can no longer check this scale, because it was set with them. Use others."
    sign_dialog(
        page,
        "Correct the z scale?",
        below,
        html.pairs(pairs) + html.note("attention", same, offered.advice),
        ("Correct the z scale", viser.Icon.ARROWS_VERTICAL),
        page.session.gauge.correct_scale,
        NOT_CORRECTED,
        signer=("Done by", "Who changes the z scale; recorded in the log"),
        name=_operator(page),
    )


def _date(event: str, text: str) -> date:
    try:
        return date.fromisoformat(text.strip())
    except ValueError as fault:
        raise MeasureError(f"The day of {event} {text.strip()!r} is not a date: write it as 2027-03-14.") from fault


def _operator(page: Page) -> str:
    data = page.session.snapshot.dataset
    sample = data.job.sample if data is not None else None
    return sample.operator if sample is not None else ""
