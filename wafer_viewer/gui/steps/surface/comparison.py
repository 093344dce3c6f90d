"""Comparisons in the left panel of the step Surface: form, list, and the numbers of the one on show."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.draw.number_format import digits_of_u, number, share, value_and_u, with_unit
from wafer_viewer.gui.dialogs.dialog import Confirm
from wafer_viewer.gui.dialogs.file_dialog import FileDialog
from wafer_viewer.gui.elements.elements import (
    Button,
    Buttons,
    Checkbox,
    Dropdown,
    Element,
    Elements,
    Html,
    Stack,
    Toggle,
)
from wafer_viewer.gui.elements.step import Here, Picks
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.preconditions import no_comparison, no_surface
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import Command, with_precondition
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.surface.comparison import (
    ALIGN_TITLES,
    FACE_TITLES,
    FOUND_BY,
    Align,
    Change,
    Comparison,
    ComparisonFace,
    Registration,
    SurfaceName,
    comparison_of,
    show_of,
)
from wafer_viewer.session.state.snapshot import Compared

CHOICES = "surfaces to compare with"
NOTHING_TO_COMPARE = "No other surface yet"
NOT_COMPARED, NOT_LISTED = "The surfaces were not compared", "Listing surfaces to compare failed"
ICON = viser.Icon
WITH_HINT, ALIGN_HINT = "The other surface", "Registration of one surface to the other before they are subtracted"
KEEP_HINT = "Keep them as measured, so that an overall change shows"
FACE_CHOICES = tuple((face, label) for face, (label, _) in FACE_TITLES.items())
OUTDATED = "One of the surfaces has changed or was deleted: compare again."
SIDE_BY_SIDE = "The second stands to the right of the first, in the same colours and range."
LITTLE_OVERLAP = 0.5
"""Overlap fraction below which the page warns that little is compared."""
_UM3_PER_PL = 1e3
_LARGE_PL = 1e3


@dataclass(frozen=True, slots=True)
class ComparisonForm:
    """Form of a new comparison; other: title of the second surface, the first of the list without one."""

    unfolded: bool = False
    other: str = ""
    align: Align = "auto"
    keeps_z: bool = False


def comparison_list(here: Here[ComparisonForm]) -> Elements | None:
    """Return the comparisons of the open dataset, the form of a new one, and the numbers of the one on show."""
    page, snapshot, view = here.page, here.snapshot, here.view
    if view.step != "surface" or snapshot.surface is None:
        return None
    shown = comparison_of(view.show)
    compared = next((c for c in snapshot.comparisons if shown is not None and c.number == shown[0]), None)
    if compared is None and view.show < 0:
        page.change(show=0, range_um=None)
    link = html.link("Less" if here.own.unfolded else "New…", "compare-new") if compared is None else Markup()
    rows = [_row(c, chosen=c is compared) for c in snapshot.comparisons]
    listed = html.table((), rows, " n") + Markup('<div style="height:8px"></div>') if rows else Markup()
    return [
        Html(html.head("Compare", link) + listed),
        Stack(tuple(_form(here))) if here.own.unfolded and compared is None else None,
        Stack(_on_show(page, compared, shown[1])) if compared is not None and shown is not None else None,
    ]


COMPARISON_PICKS: Picks[ComparisonForm] = {
    "compare-new": lambda here, _: unfold(here),
    "compare-look": lambda here, key: look(here.page, int(key), ComparisonFace.DIFFERENCE),
    "compare-remove": lambda here, key: _remove(here.page, int(key)),
}


def comparison_commands(here: Here[ComparisonForm]) -> list[Command]:
    """Return the comparison commands with their keys."""
    page = here.page
    return [
        *with_precondition(
            no_surface,
            Command("Compare surfaces…", None, lambda: unfold(here), ICON.ARROWS_DIFF, group="Surface"),
        ),
        *with_precondition(
            no_comparison,
            Command("First or second surface", "B", lambda: blink(page), ICON.SWITCH_HORIZONTAL, "shift", "Surface"),
            Command("Close the comparison", None, lambda: close(page), ICON.X, group="Surface"),
        ),
    ]


def unfold(here: Here[ComparisonForm]) -> None:
    """Unfold or fold the form."""
    here.page.change(step="surface")
    here.keep(unfolded=not here.own.unfolded)


def look(page: Page, number: int, face: ComparisonFace) -> None:
    """Show a face of a comparison."""
    page.change(show=show_of(number, face), range_um=None, frame_k=None, slice_z_um=None, why=None)


def blink(page: Page) -> None:
    """Switch between the first and the second surface with the same camera."""
    if (shown := comparison_of(page.view.show)) is not None:
        is_second = shown[1] is ComparisonFace.SECOND
        look(page, shown[0], ComparisonFace.FIRST if is_second else ComparisonFace.SECOND)


def close(page: Page) -> None:
    """Close the comparison and show the surface again."""
    if page.view.show < 0:
        page.change(show=0, range_um=None)


def _form(here: Here[ComparisonForm]) -> Iterator[Element]:
    """Yield the inputs of a new comparison; the surfaces are listed whenever they may have changed."""
    page, own, snapshot, show = here.page, here.own, here.snapshot, here.view.show
    data, info = snapshot.dataset, snapshot.surface
    stamp = (data and (data.path, data.results), info and info.result, snapshot.datasets, show)
    listed = here.ask(CHOICES, stamp, lambda: page.session.comparing.choices(show), NOT_LISTED).value or ()
    pairs = {pair_label(first, second): (first, second) for first, second in listed}
    titles = tuple(pairs) or (NOTHING_TO_COMPARE,)
    other = own.other if own.other in titles else titles[0]
    aligns: dict[str, Align] = {title: key for key, title in ALIGN_TITLES.items()}

    def begin() -> None:
        if other in pairs:
            _compare(here, *pairs[other])

    yield Dropdown("Compare with", other, lambda title: here.keep(other=title), WITH_HINT, options=titles)
    yield Dropdown(
        "Align",
        ALIGN_TITLES[own.align],
        lambda title: here.keep(align=aligns[title]),
        ALIGN_HINT,
        options=tuple(aligns),
    )
    yield Checkbox("Keep height and tilt", own.keeps_z, lambda keeps: here.keep(keeps_z=keeps), KEEP_HINT)
    compare = Button(
        "Compare", begin, ICON.ARROWS_DIFF, disabled=not pairs, commands=True, failed="Nothing was compared"
    )
    yield Buttons([compare, Button("From a file…", lambda: _ask_other(here), ICON.FOLDER_OPEN)], 34)
    yield Html(html.remark("Not yet: there is no other surface in the data folder.") if not pairs else "")


def _on_show(page: Page, compared: Compared, face: ComparisonFace) -> Elements:
    return [
        Toggle("Look at", face, lambda to: look(page, compared.number, to), "", options=FACE_CHOICES),
        Buttons([Button("Close comparison", lambda: close(page), ICON.X)]),
        Html(_summary_html(compared, face)),
    ]


def _ask_other(here: Here[ComparisonForm]) -> None:
    """Open the dialog that compares with any dataset or surface file."""
    page = here.page
    below = "A stitched dataset NAME.wafer, or a surface file: it is laid over what is on show and subtracted."

    def begin(dialog: FileDialog[None]) -> None:
        snapshot, path = page.session.snapshot, dialog.path()
        if snapshot.dataset is None or snapshot.surface is None:
            raise DatasetError("Nothing is open to compare with: open a dataset with a surface first.")
        opened, field = snapshot.dataset, max(page.view.show, 0)
        first = SurfaceName(path=str(opened.path), result=snapshot.surface.result, field=field)
        _compare(here, first, SurfaceName(path=str(path)))

    answer = Confirm("Compare", ICON.ARROWS_DIFF, begin, "Nothing was compared")
    FileDialog(page, "Compare with another surface", below, answer, "surface")


def _compare(here: Here[ComparisonForm], first: SurfaceName, second: SurfaceName) -> None:
    page, own = here.page, here.own
    done = page.session.comparing.begin(first, second, own.align, own.keeps_z)
    here.keep(unfolded=False)
    page.ask(NOT_COMPARED, done, lambda number: look(page, int(number), ComparisonFace.DIFFERENCE))


def _remove(page: Page, number: int) -> None:
    if (shown := comparison_of(page.view.show)) is not None and shown[0] == number:
        close(page)
    page.ask("The comparison was not removed", page.session.comparing.remove(number))


def _row(compared: Compared, chosen: bool) -> Markup:
    name = comparison_name(compared.comparison)
    away = Markup('<span class="wv-link" title="Remove" {}>').format(
        html.command_pick("compare-remove", str(compared.number))
    )
    cells = (name, Markup("{}{}</span>").format(away, html.icon(ICON.X, 14)))
    return html.row(cells, " n", html.pick("compare-look", str(compared.number)), "sel" if chosen else "")


def _summary_html(compared: Compared, face: ComparisonFace) -> Markup:
    comparison: Any = compared.comparison
    side_by_side = html.remark(SIDE_BY_SIDE) if face is ComparisonFace.BESIDE else Markup()
    return (
        Markup('<div class="wv-lab" style="margin-bottom:8px">{}</div>').format(surfaces_sentence(comparison))
        + side_by_side
        + change_figures(comparison.change)
        + warnings(comparison, compared.outdated)
        + change_numbers(comparison.change)
        + alignment(comparison.registration)
    )


def pair_label(first: SurfaceName, second: SurfaceName) -> str:
    """Return the label of a pair of surfaces in the list."""
    if (first.path, first.result, first.field) == (second.path, second.result, second.field):
        return "Measured and filtered"
    return f"Result {second.result}" if first.path == second.path else second.words


def comparison_name(comparison: Comparison) -> str:
    """Return the name of a comparison in the list."""
    return pair_label(comparison.first, comparison.second)


def surfaces_sentence(comparison: Comparison) -> str:
    """Return a sentence that names the first and the second surface."""
    return f"First: {comparison.first.words}. Second: {comparison.second.words}."


def change_figures(change: Change) -> Markup:
    """Return the main figures: changed area in % and Sq of the difference in µm."""
    return html.columns(
        [
            html.figure("Changed", number(100 * change.changed_fraction, 1), "%", 26),
            html.figure("Sq of difference", number(change.sq_um, 2), "µm", 26),
        ]
    )


def change_numbers(change: Change) -> Markup:
    """Return the table of difference statistics."""
    rows = [
        ("Mean", with_unit(change.mean_um, 3, signed=True)),
        ("Lowest", with_unit(change.lowest_um, 2, signed=True)),
        ("Highest", with_unit(change.highest_um, 2, signed=True)),
        ("Counts as changed", f"beyond ±{with_unit(change.limit_um, 2)}"),
        ("Volume gained", volume(change.gained_um3)),
        ("Volume lost", volume(change.lost_um3)),
        ("Places compared", number(change.n_points, 0)),
    ]
    return html.head("Second − first") + html.pairs(rows)


def volume(um3: float) -> str:
    """Format a volume in pl, from 1000 pl on in nl."""
    pl = um3 / _UM3_PER_PL
    return with_unit(pl / _LARGE_PL, 2, "nl") if pl >= _LARGE_PL else with_unit(pl, 2, "pl")


def alignment(registration: Registration) -> Markup:
    """Return the table of registration parameters of the second surface, each with its U."""
    rows = [("Found", FOUND_BY[registration.by])] if registration.by == "same" else []
    if registration.by in ("images", "heights"):
        rows += [
            ("Shift x", _with_u(registration.x_um, registration.u_xy_um, "µm")),
            ("Shift y", _with_u(registration.y_um, registration.u_xy_um, "µm")),
            ("Turn", _with_u(registration.turn_mrad, registration.u_turn_mrad, "mrad")),
        ]
    if registration.levelled:
        rows += [
            ("Height", _with_u(registration.z_um, registration.u_z_um, "µm")),
            ("Tilt along x", _with_u(registration.tilt_x_mrad, registration.u_tilt_mrad, "mrad")),
            ("Tilt along y", _with_u(registration.tilt_y_mrad, registration.u_tilt_mrad, "mrad")),
            ("Residual, rms", with_unit(registration.residual_um, digits_of_u(registration.residual_um))),
        ]
    rows.append(("Share of the first compared", share(registration.overlap_fraction)))
    how = Markup() if registration.by == "same" else html.remark(f"Found {FOUND_BY[registration.by]}; k = 2.")
    return html.head("Alignment") + how + html.pairs(rows)


def warnings(comparison: Comparison, outdated: bool) -> Markup:
    """Return warnings: outdated surface, small overlap, missing or different calibration."""
    warnings = [OUTDATED] if outdated else []
    if comparison.registration.overlap_fraction < LITTLE_OVERLAP:
        warnings.append(
            f"Only {share(comparison.registration.overlap_fraction)} of the first surface lies on the second."
        )
    if not comparison.calibrated:
        warnings.append("Lengths are uncalibrated, or the calibrations differ.")
    return Markup("").join(
        Markup('<div class="wv-lab" style="margin:4px 0">{}</div>').format(text) for text in warnings
    )


def _with_u(value: float, expanded: float | None, unit: str) -> str:
    shown, u = value_and_u(value, expanded, signed=True)
    return f"{shown} {unit}" if expanded is None else f"{shown} ± {u} {unit}"
