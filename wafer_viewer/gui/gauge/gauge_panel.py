"""Panel of the gauge check: verdict, evidence, conditions, and the commands that lead to a signed check."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any, Literal

import viser
from markupsafe import Markup

from wafer_viewer.draw.number_format import number, with_unit
from wafer_viewer.gui.gauge.gauge_displays import LIVE_STEP, selected_check
from wafer_viewer.gui.measure.live_measurement import live_measurement
from wafer_viewer.gui.page.dialogs import Dialog
from wafer_viewer.gui.page.file_dialog import FileList
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.preconditions import require_step
from wafer_viewer.gui.presenters import gauge as unsure
from wafer_viewer.gui.presenters import gauge as words
from wafer_viewer.gui.presenters.gauge import BY_HAND, METHODS, next_point, study
from wafer_viewer.gui.presenters.verdict import LOOKS
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.tools.region_tools import default_faces, in_scene
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.ask import Answer
from wafer_viewer.gui.widgets.callbacks import Debouncer, LatestOnlyWorker, guarded
from wafer_viewer.gui.widgets.controls import (
    BoundInput,
    Command,
    HtmlBlock,
    add_html,
    button,
    command_button,
    controlled,
    duo,
    in_a_row,
    leading,
    set_prop,
    with_precondition,
)
from wafer_viewer.gui.widgets.number_field import OptionalNumber, text_of
from wafer_viewer.gui.widgets.style import by_id
from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.gauge import Certificate, GaugeCheck, Method, ScaleCorrection
from wafer_viewer.model.measurement.measurements import StepHeight
from wafer_viewer.model.spec import replace
from wafer_viewer.session.state.snapshot import Snapshot

Surface = tuple[Path, int, int]
"""Dataset path, displayed field (0 for the stitched surface) and stamp of the surface."""


class FaceFinder:
    """Finder of the two faces, run when there are no faces of this dataset yet, and on request.

    problem: why no faces were found, or empty; looking: whether a search is running.
    """

    def __init__(self, page: Page) -> None:
        self._page = page
        self._worker = LatestOnlyWorker("faces")
        self._looked_at: Surface | None = None
        self.problem = ""
        self.looking = False
        page.on_close(self._worker.close)

    def follow(self, snapshot: Snapshot, view: View) -> None:
        """Start a search if a surface without faces is displayed."""
        surface = _surface(snapshot, view)
        if surface is None or surface == self._looked_at:
            return
        of_others = self._looked_at is not None and self._looked_at[0] != surface[0]
        if of_others or not view.faces:
            self._look(surface)
        self._looked_at = surface

    def again(self) -> None:
        """Search again and replace the present regions."""
        surface = _surface(self._page.session.snapshot, self._page.view)
        if surface is not None:
            self._look(surface)

    def place_default_regions(self) -> None:
        """Place the regions at default positions, to be dragged by hand."""
        info = self._page.session.snapshot.surface
        if info is not None:
            self.problem = ""
            self._page.change(faces=default_faces(info))

    def _look(self, surface: Surface) -> None:
        self._looked_at, self.looking, self.problem = surface, True, ""
        self._worker.ask(lambda: guarded(self._page, "The faces were not found")(self._find)(self._page.view.show))
        self._page.redraw()

    def _find(self, show: int) -> None:
        try:
            faces = self._page.session.gauge.find_faces(max(0, show))
            self._page.change(faces=faces)
        except WaferViewerError as fault:
            self.problem = str(fault)
        finally:
            self.looking = False
            self._page.redraw()


def _surface(snapshot: Snapshot, view: View) -> Surface | None:
    """Return the key of the displayed surface; None without one, or during a scan."""
    data = snapshot.dataset
    if data is None or snapshot.surface is None or snapshot.scanning:
        return None
    return data.path, max(0, view.show), snapshot.surface.stamp


Lead = Literal["certificate", "measure", "sign", "new"]
"""Command of the leading (filled) button."""


class GaugeActions:
    """Commands of a gauge check, for buttons, keys and clicks."""

    def __init__(self, page: Page, finder: FaceFinder) -> None:
        self._page, self._finder = page, finder
        page.on_pick("gauge-tick", self._tick)
        page.on_pick(
            "gauge-drop", lambda k: page.ask("The repeat was not changed", page.session.gauge.drop_repeat(int(k)))
        )
        page.on_pick("gauge-lay", lambda _: finder.place_default_regions())
        page.on_pick("gauge-find", lambda _: finder.again())

    def go_on(self) -> None:
        """Carry out the next point of the procedure, or ask for the certificate if it is missing."""
        snapshot = self._page.session.snapshot
        point = next_point(snapshot)
        if point is None:
            self.begin_anew()
        elif point.name in BY_HAND:
            self._tick(point.name)
        elif point.name == "scan":
            self._page.change(step="plan")
        elif snapshot.gauge.certificate is None:
            self.certificate()
        elif point.name == "faces":
            self.measure()
        else:
            self.sign()

    def measure(self) -> None:
        """Measure the step between the regions and add it as a repeat."""
        view = self._page.view
        upper, lower = view.faces or (None, None)
        taken = self._page.session.gauge.add_repeat(upper, lower, max(0, view.show))
        self._page.ask("The step was not measured", taken, lambda _: self._page.change(check=None))

    def sign(self) -> None:
        """Open the dialog that signs the check."""
        check = self._page.session.snapshot.gauge.check
        if check is not None:
            guarded(self._page, "The check was not signed")(sign_dialog)(self._page, check)

    def certificate(self) -> None:
        """Open the dialog that loads a certificate."""
        guarded(self._page, "The certificate was not loaded")(certificate_dialog)(self._page)

    def correct(self) -> None:
        """Open the dialog that corrects the z scale, if a correction is proposed."""
        offered = self._page.session.snapshot.gauge.correction
        if offered is not None:
            guarded(self._page, "The z scale was not changed")(correct_dialog)(self._page, offered)

    def begin_anew(self) -> None:
        """Start a new check of the same blocks."""
        self._page.ask(
            "The check was not changed", self._page.session.gauge.clear(), lambda _: self._page.change(check=None)
        )

    def leading(self, snapshot: Snapshot) -> Lead:
        """Return the command of the leading button."""
        gauge = snapshot.gauge
        if gauge.signed is not None:
            return "new"
        if gauge.check is not None:
            return "sign"
        return "certificate" if gauge.certificate is None else "measure"

    def why_not(self, snapshot: Snapshot, view: View, verb: Lead) -> str | None:
        """Return the reason why a command is not possible now, to follow "Not yet:"; None if it is."""
        gauge, data = snapshot.gauge, snapshot.dataset
        if verb == "measure":
            if gauge.busy:
                return "a repeat is being measured."
            if snapshot.surface is None:
                return "there is no surface to measure on."
            return gauge.refusal or (None if view.faces else "the regions do not lie on the faces yet.")
        if verb == "sign" and data is not None and data.read_only is not None:
            return data.read_only
        return None

    def _tick(self, point: str) -> None:
        done = any(tick.point == point for tick in self._page.session.snapshot.gauge.ticks)
        self._page.ask("The point was not changed", self._page.session.gauge.tick(point, not done))


FAILED = "The terms of the check were not changed"


class TermsSection:
    """Numeric fields of the terms; quantities that need an empty one are not evaluated."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._edits = Debouncer(self._put, guarded(page, FAILED))
        self._folder = page.gui.add_folder(None, visible=False)
        with self._folder:
            HtmlBlock(page.gui, html.head("Terms"))
            self._fields = {
                "limit_um": self._number("Limit, ± µm", over=0),
                "temperature_c": self._number("Blocks, °C"),
                "tolerance_um": self._number("Tolerance, µm", over=0),
                "interval_days": self._number("Next in, days", over=0, integer=True),
            }

    def show(self, snapshot: Snapshot, earlier: bool) -> None:
        """Bring the numbers up to date; they are hidden for an earlier check."""
        set_prop(self._folder, "visible", not earlier)
        for name, (_, field) in self._fields.items():
            field.show(text_of(getattr(snapshot.gauge.terms, name)))

    def _number(
        self, label: str, over: float | None = None, integer: bool = False
    ) -> tuple[OptionalNumber, BoundInput[str]]:
        number = OptionalNumber(self._page.gui, label, over=over, integer=integer)
        return number, BoundInput(controlled(number.handle), lambda _: self._edits.made(), self._page, FAILED)

    def _put(self) -> Future[Any] | None:
        put_in: dict[str, Any] = {name: number.value for name, (number, _) in self._fields.items()}
        terms = self._page.session.snapshot.gauge.terms
        days = put_in["interval_days"]
        put_in["interval_days"] = terms.interval_days if days is None else int(days)
        answer = self._page.session.gauge.set_terms(replace(terms, **put_in))
        self._page.ask(FAILED, answer)
        return answer


STUDY_FAILED = "The study was not read"
METHOD_OF: dict[str, Method] = {word.capitalize(): method for method, word in METHODS.items()}
HEAD = "Repeatability and reproducibility"


class StudySection:
    """Result of the last study in this browser, and the button for a new one."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._studies = ""
        self._cell = HtmlBlock(page.gui)
        ask = guarded(page, STUDY_FAILED)(lambda _: self.ask())
        in_a_row(page.gui, [button(page.gui, "Gauge R&R study…", viser.Icon.TABLE_IMPORT, ask)])

    def show(self) -> None:
        """Bring the section up to date."""
        what = "Share of the variation that comes from the gauge, by AIAG."
        waits = Markup('<div class="wv-lab" style="margin-bottom:6px">{}</div>').format(what)
        self._cell.show(html.head(HEAD) + (self._studies or waits))

    def ask(self) -> None:
        """Open the dialog that reads a study with a method and a tolerance."""
        below = "A CSV with the columns part, appraiser and value, or a folder of repeat scans of wafers with a job."
        dialog = Dialog(self._page, "Gauge R&R study", below)
        gui = self._page.gui
        with dialog.modal:
            files = FileList(dialog, "study", rows=6)
            files.add_upload("text/csv")
            method = gui.add_dropdown("Method", tuple(METHOD_OF))
            tolerance = OptionalNumber(gui, "Tolerance", over=0)

        def read() -> None:
            self._read(files.path(), method.value, tolerance.value)

        dialog.answers("Read the study", viser.Icon.TABLE_IMPORT, read, STUDY_FAILED, needs_control=False)

    def _read(self, path: Path, method: str, tolerance: float | None) -> None:
        made = self._page.session.studies.gauge_rr(path, METHOD_OF[method], tolerance)
        self._studies = Markup("").join(study(one) for one in made)
        self._page.redraw()


ICON = viser.Icon
LEAD_PX = 58
"""Height of the leading button with its margins."""
NO_SURFACE = "No surface of the blocks yet.", "Wring them and scan them, or open their dataset."


class GaugePanel:
    """Panel of the present check, or of an earlier one selected on the left."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._live: Answer[AnyResult] = Answer()
        self.finder = FaceFinder(page)
        self._verbs = GaugeActions(page, self.finder)
        self._folder = page.gui.add_folder(None, visible=False)
        with self._folder:
            self._build()

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the panel up to date; find the faces, and measure the step again if they moved."""
        visible = view.checks_blocks and not view.explains
        set_prop(self._folder, "visible", visible)
        if not visible:
            return
        self.finder.follow(snapshot, view)
        self._live = live_measurement(self._page, LIVE_STEP, snapshot, in_scene(view))
        earlier = selected_check(snapshot, view)
        check = earlier or snapshot.gauge.signed or snapshot.gauge.check
        self._title.show(_title(earlier))
        self._notes.show(self._page.notes(snapshot))
        self._show_state(snapshot, view, earlier)
        self._verdict.show(words.verdict_card(check) + words.result(check) if check is not None else "")
        self._show_paper(snapshot, earlier, check)
        self._terms.show(snapshot, earlier is not None)
        self._show_sums(snapshot, view, earlier, check)
        self._studies.show()
        self._show_verbs(snapshot, view, earlier)

    def commands(self) -> list[Command]:
        """Return the commands of a check with their keys."""
        verbs = self._verbs

        def here(_: Snapshot, view: View) -> bool:
            return view.checks_blocks

        return [
            Command("Next point of the check", "enter", verbs.go_on, ICON.ARROW_RIGHT, group="Gauge check", here=here),
            *with_precondition(
                require_step("gauge"),
                Command("Measure the step", None, verbs.measure, ICON.RULER_MEASURE, group="Gauge check"),
                Command("Find the faces", None, self.finder.again, ICON.SEARCH, group="Gauge check"),
                Command("Sign the check…", None, verbs.sign, ICON.SIGNATURE, group="Gauge check"),
                Command("Certificate…", None, verbs.certificate, ICON.CERTIFICATE, group="Gauge check"),
                Command("Begin a new check", None, verbs.begin_anew, ICON.PLUS, group="Gauge check"),
            ),
        ]

    def _build(self) -> None:
        gui, verbs = self._page.gui, self._verbs
        self._title, self._notes, self._state, self._verdict = (HtmlBlock(gui) for _ in range(4))
        self._paper = HtmlBlock(gui)
        self._terms = TermsSection(self._page)
        self._sums = HtmlBlock(gui)
        self._scale = HtmlBlock(gui)
        self._correct = command_button(
            gui,
            "Correct the z scale…",
            ICON.ARROWS_VERTICAL,
            lambda _: verbs.correct(),
            action="Scale of z corrected",
        )
        in_a_row(gui, [self._correct])
        self._studies = StudySection(self._page)
        HtmlBlock(gui, Markup('<div style="height:10px"></div>'))
        self._why = HtmlBlock(gui)
        self._again = command_button(gui, "Measure again", ICON.REFRESH, lambda _: verbs.measure())
        self._other = command_button(gui, "Certificate…", ICON.CERTIFICATE, lambda _: verbs.certificate())
        in_a_row(gui, [self._again, self._other], 34)
        add_html(gui, html.style_sheet(at_foot(self._again) + at_foot(self._other)))
        self._leads = {
            "certificate": command_button(
                gui, "Load the certificate…", ICON.CERTIFICATE, lambda _: verbs.certificate()
            ),
            "measure": command_button(gui, "Measure the step", ICON.RULER_MEASURE, lambda _: verbs.measure()),
            "sign": command_button(gui, "Sign and save", ICON.SIGNATURE, lambda _: verbs.sign()),
            "new": command_button(gui, "New check", ICON.PLUS, lambda _: verbs.begin_anew()),
        }
        for handle in self._leads.values():
            leading(gui, handle)

    def _show_state(self, snapshot: Snapshot, view: View, earlier: GaugeCheck | None) -> None:
        gauge = snapshot.gauge
        if earlier is not None:
            self._state.show("")
        elif gauge.refusal is not None:
            self._state.show(words.rejected_scan_note(gauge.refusal, bool(gauge.repeats)))
        elif snapshot.surface is None and not gauge.repeats:
            self._state.show(html.empty(*NO_SURFACE))
        else:
            self._state.show(self._faces_state_html(snapshot, view))

    def _faces_state_html(self, snapshot: Snapshot, view: View) -> Markup:
        """Return the state of the face regions before the step is measured, as HTML."""
        if self.finder.looking:
            return html.empty("Looking for the two faces.")
        if self.finder.problem and not view.faces:
            link = Markup('<span class="wv-link" {}>Place the regions by hand</span>').format(html.pick("gauge-lay"))
            return html.note("attention", "The faces were not found", self.finder.problem, link)
        if view.faces and not isinstance(self._live.value, StepHeight) and self._live.problem:
            return html.note("attention", "Nothing is measured there", self._live.problem)
        waits = snapshot.gauge.check is None and snapshot.gauge.signed is None and bool(view.faces)
        return html.empty("Drag the regions onto the two faces, then measure.") if waits else Markup()

    def _show_paper(self, snapshot: Snapshot, earlier: GaugeCheck | None, check: GaugeCheck | None) -> None:
        paper = earlier.certificate if earlier is not None else snapshot.gauge.certificate
        taken = earlier.repeats if earlier is not None else snapshot.gauge.repeats
        may_drop = earlier is None and bool(snapshot.gauge.repeats)
        self._paper.show(words.repeats(taken, check, may_drop) + words.certificate(paper, date.today()))

    def _show_sums(self, snapshot: Snapshot, view: View, earlier: GaugeCheck | None, check: GaugeCheck | None) -> None:
        live = self._live.value
        step = live if isinstance(live, StepHeight) and earlier is None else None
        upper, lower = (check.upper, check.lower) if check is not None else view.faces or (None, None)
        parts = [words.conditions(step, check, upper, lower)]
        if check is not None:
            parts += [unsure.budget(check), unsure.not_evaluated(check)]
        if earlier is None:
            parts.append(unsure.capability(snapshot.gauge.capability))
        self._sums.show(Markup("").join(parts))
        offered = snapshot.gauge.correction if earlier is None else None
        self._scale.show(unsure.correction(offered))
        set_prop(self._correct, "visible", offered is not None)

    def _show_verbs(self, snapshot: Snapshot, view: View, earlier: GaugeCheck | None) -> None:
        gauge, own = snapshot.gauge, earlier is None
        lead = self._verbs.leading(snapshot) if own else "new"
        for name, handle in self._leads.items():
            set_prop(handle, "visible", own and name == lead)
        why_not = self._verbs.why_not(snapshot, view, lead)
        set_prop(self._leads[lead], "disabled", why_not is not None)
        set_prop(self._again, "visible", own)
        set_prop(self._other, "visible", own)
        may_measure = self._verbs.why_not(snapshot, view, "measure") is None
        set_prop(self._again, "disabled", not (may_measure and gauge.repeats))
        why = (
            Markup('<div class="wv-why">Not yet: {}</div>').format(html.with_micro_sign(why_not))
            if why_not
            else Markup()
        )
        self._why.show(why if own else "")


def at_foot(handle: Any) -> str:
    """Return CSS that keeps a button visible above the leading button while the panel scrolls."""
    selector, sticks = by_id(handle._impl.uuid), f"position:sticky;bottom:{LEAD_PX}px;z-index:3;padding-top:6px"
    return f"div:has(>{selector}){{{sticks};background:var(--panel);box-shadow:6px 0 0 var(--panel)}}"


def _title(earlier: GaugeCheck | None) -> Markup:
    if earlier is None:
        return html.title("Gauge check", "Two gauge blocks, step against the certificate.")
    back = Markup('<span class="wv-action" {}>Back to this check</span>').format(html.pick("gauge-record", earlier.at))
    below = f"Signed by {earlier.signed_by}, {words.day_and_time(earlier.at)}."
    return html.title("Earlier check", below, back)


WAIT_S = 20.0
"""Timeout for a session command, which is awaited so that the dialog can show its error."""
NOT_TAKEN = "The certificate was not loaded"


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
            _wait(page.session.gauge.load_certificate(files.path()))
        else:
            _wait(page.session.gauge.put_certificate(_typed(form)))

    dialog.answers("Use certificate", viser.Icon.CERTIFICATE, take, NOT_TAKEN)


def sign_dialog(page: Page, check: GaugeCheck) -> None:
    """Open the dialog that signs a check; it repeats verdict and error and asks for a name."""
    word, _, tone = LOOKS[check.verdict]
    dialog = Dialog(
        page, "Sign this check?", "It is saved with the dataset and in the log of checks and cannot be changed."
    )
    error = with_unit(check.deviation.value_um, 3, signed=True)
    summary = Markup('<b style="color:var(--{tone})">{word}</b> · error {error} · {n} scan{n2}').format(
        tone=tone, word=word, error=error, n=check.n, n2="" if check.n == 1 else "s"
    )
    with dialog.modal:
        HtmlBlock(page.gui, Markup('<div style="padding:2px 0 8px">{}</div>').format(summary))
        name = page.gui.add_text("Signed by", page.browser.name or _operator(page))

    def sign() -> None:
        if not name.value.strip():
            raise MeasureError("The signature is missing: type your name.")
        _wait(page.session.gauge.sign(name.value.strip()))
        page.change(check=None)

    dialog.answers("Sign and save", viser.Icon.SIGNATURE, sign, "The check was not signed")


def correct_dialog(page: Page, offered: ScaleCorrection) -> None:
    """Open the dialog that corrects the z scale; it shows the change and asks for a name and a reason."""
    below = "Scans from now on are taken with the new scale. Datasets and signed checks stay as they are."
    dialog = Dialog(page, "Correct the z scale?", below)
    now = page.session.snapshot.rig.calibration
    pairs = [
        ("z scale now", number(now.z_scale, 6) if now is not None else "none"),
        ("z scale then", number(offered.calibration.z_scale, 6)),
        ("The checked step changes by", with_unit(offered.changes_um, 3, signed=True)),
        ("Set against then", offered.calibration.against),
    ]
    with dialog.modal:
        HtmlBlock(page.gui, html.pairs(pairs) + _warned(offered))
        name = page.gui.add_text("Done by", page.browser.name or _operator(page))
        why = page.gui.add_text("Reason", "")

    def correct() -> None:
        if not name.value.strip():
            raise MeasureError("The name for the correction is missing: type your name.")
        _wait(page.session.gauge.correct_scale(name.value.strip(), why.value.strip()))

    dialog.answers("Correct the z scale", viser.Icon.ARROWS_VERTICAL, correct, "The z scale was not changed")


def _warned(offered: ScaleCorrection) -> Markup:
    same = "These blocks can no longer check this scale, because it was set with them. Use others."
    return html.note("attention", same, offered.advice)


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


def _wait(verb: Future[Any]) -> None:
    verb.result(WAIT_S)
