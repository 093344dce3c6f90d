"""Page of a run: the paper's tables and figures beside ours, as one HTML file and, without figures, as Markdown."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.draw.charts.profile_plot import curves_svg
from wafer_viewer.draw.number_format import duration, number, share, size, with_unit
from wafer_viewer.model.report import Figure, Pairs, Report, ReportSection, Table
from wafer_viewer.model.surface.height_map import HeightMap, Origin
from wafer_viewer.session.reporting.report_pictures import map_picture
from wafer_viewer.session.reproduction.paper_samples import DEFAULT, METHODS, PaperSample
from wafer_viewer.session.reproduction.published import (
    CERTIFIED_UM,
    FILTERED,
    FLATNESS,
    HEIGHT,
    HEIGHT_ERROR,
    MEASURES,
    PAPER_METHODS,
    SMOOTHNESS,
    STAIR,
    TIMES,
    PublishedRow,
)
from wafer_viewer.session.reproduction.reproduction import InspectionRecord, Reproduction, StepRecord
from wafer_viewer.session.reproduction.surface_figures import (
    PICTURE_PX,
    SHARES_OF_THE_PAPER,
    SurfaceFigures,
)
from wafer_viewer.store.io.atomic_files import write_text
from wafer_viewer.store.mosaic.poses_file import read_planes
from wafer_viewer.store.records.conformance_reports import write_report

COLUMNS = (*PAPER_METHODS, DEFAULT)
NOT_AVAILABLE = "n. a."
"""Text for what our copy of the paper lacks."""
BEYOND = 0.3
"""Margin of the heights of a plot, as a fraction of the range of the sample."""
DRAWN_CUTS = ("TEN", "TEN_LW", DEFAULT)
FALSE = "False: off by more than a step."
METHOD_NOTES = (
    "GLV, SML, TEN: the paper's method, argmax without a filter. _LW: with its filter. Default: our default recipe, "
    "whose ratio is to the paper's TEN_LW.",
    "The paper leaves window, step size, iterations and threshold open, so these are ours: wafer-viewer reconstruct "
    "--recipe paper.",
    "The Lévy filter is that of the printed equations. They measure a step against the noisy map itself and so keep "
    "the noise; what the paper reports needs another reading of them, such as our levy.mode = guided.",
    f"{NOT_AVAILABLE}: not available in our copy of the paper.",
)


def write_page(run: Reproduction) -> Path:
    """Write the page of a run, and its tables as Markdown beside it; return the page."""
    report = page_of(run)
    write_report(report, run.page)
    write_text(run.page.with_suffix(".md"), markdown(report))
    return run.page


def page_of(run: Reproduction) -> Report:
    """Return the contents of the page; steps that are not done are shown as such."""
    samples = {sample.name: sample for sample in run.samples}
    stair, blocks, wafer = (samples[name] for name in ("stair", "gauge_blocks", "wafer"))
    begun = run.begun
    kind = "reduced run: a few small fields" if begun.reduced else "full size"
    return Report(
        title="The paper's jobs on the virtual rig",
        below=f"{kind}, {begun.begun}, {begun.machine}, Wafer Viewer {begun.software_version}",
        simulated=True,
        facts=(),
        sections=(
            ReportSection("Columns of the tables", sentences=METHOD_NOTES),
            _stair(run, stair),
            _smoothness(run, (blocks, wafer)),
            _height(run, blocks),
            _times(run, blocks, "Table 5: times of the gauge blocks"),
            _times(run, wafer, "Table 6: times of the wafer"),
            ReportSection("Figure 7: heights of the wafer", figures=_pictures(run, wafer), empty="Not done."),
            _cuts(run, wafer),
            _inspection(run, wafer),
            _resources(run),
        ),
    )


# -------------------------------------------------------------------------------------------------------------- values


def _value(run: Reproduction, sample: PaperSample, method: str, quantity: str) -> float | None:
    """Return a quantity of a method from the records of its steps; None if it is not there."""
    if quantity == "acquisition_s":
        scan = run.record(f"{sample.name}-scan", StepRecord)
        return None if scan is None else sum(part.instrument_s for part in scan.parts)
    if quantity in ("frame_ms", "stitching_s"):
        surface = run.record(f"{sample.name}-{method}-surface", StepRecord)
        if surface is None:
            return None
        return surface.frame_ms if quantity == "frame_ms" else surface.parts[-1].stitching_s
    figures = run.record(f"{sample.name}-{method}-figures", SurfaceFigures)
    return None if figures is None else figures.values.get(quantity)


def _ours(run: Reproduction, sample: PaperSample, quantity: str) -> list[float | None]:
    return [_value(run, sample, method, quantity) for method in COLUMNS]


def _rows(run: Reproduction, sample: PaperSample, published: PublishedRow) -> Iterator[tuple[str, ...]]:
    """Yield the paper's row, ours, and the ratio where both have a number; of the default to the paper's TEN_LW."""
    ours, digits = _ours(run, sample, published.quantity), published.digits
    theirs = (NOT_AVAILABLE if value is None else _text(value, digits) for value in published.values)
    yield (f"{published.title}: paper", *theirs, "")
    yield ("ours", *(_text(value, digits) for value in ours))
    ratios = [
        _text(own / paper, digits) if isinstance(paper, int | float) and own is not None else ""
        for own, paper in zip(ours, (*published.values, published.values[-1]), strict=True)
    ]
    if any(ratios):
        yield ("ours / paper", *ratios)


def _row(run: Reproduction, sample: PaperSample, title: str, quantity: str) -> tuple[str, ...]:
    text = share if quantity.endswith("fraction") else _text
    return (title, *map(text, _ours(run, sample, quantity)))


def _text(value: float | str | None, digits: int = 4) -> str:
    """Return significant digits of a number; a dash for what is not there."""
    if isinstance(value, str):
        return value
    if value is None or math.isnan(value):
        return "–"
    if value and not 1e-3 <= abs(value) < 1e6:
        factor, power = f"{value:.2e}".split("e")
        return f"{factor}e{int(power)}"
    return f"{value:.{digits}g}" if abs(value) < 1e4 else number(value, 0)


def _table(rows: Iterable[tuple[str, ...]]) -> Table:
    return Table(("", *COLUMNS), tuple(rows), " " + "n" * len(COLUMNS))


# -------------------------------------------------------------------------------------------------------------- tables


def _stair(run: Reproduction, sample: PaperSample) -> ReportSection:
    rows = [row for published in STAIR for row in _rows(run, sample, published)]
    rows += [_change(run, sample, published) for published in STAIR]
    rows += [
        _row(run, sample, "With a height", "heights_fraction"),
        _row(run, sample, "False", "false_fraction"),
    ]
    return ReportSection(
        "Table 2 and Figure 5: simulated stair",
        table=_table(rows),
        sentences=(
            "One field of a stair, treads 20 µm apart, steps of 4 µm. The peak of the PSNR is the range of the true "
            "heights; the paper does not give its own.",
            f"Change: by the filter; of the default against TEN. {FALSE}",
        ),
        figures=_pictures(run, sample),
    )


def _change(run: Reproduction, sample: PaperSample, published: PublishedRow) -> tuple[str, ...]:
    """Return the change of a quantity by the filter in percent, and of the default against TEN."""
    values = dict(zip(COLUMNS, _ours(run, sample, published.quantity), strict=True))
    pairs = {f"{measure}{FILTERED}": measure for measure in MEASURES} | {DEFAULT: "TEN"}

    def text(method: str) -> str:
        before, after = values[pairs[method]] if method in pairs else None, values[method]
        return f"{100 * (after / before - 1):+.1f} %" if before is not None and before > 0 and after is not None else ""

    return (f"{published.title.split(',')[0]}: change", *map(text, COLUMNS))


def _smoothness(run: Reproduction, samples: Iterable[PaperSample]) -> ReportSection:
    rows = [row for sample in samples for row in _rows(run, sample, SMOOTHNESS[sample.name])]
    return ReportSection(
        "Table 3: smoothness",
        table=_table(rows),
        sentences=(
            "SSM of eq. 19, mean over the pixels of the mosaic with nine heights about them. It rewards smoothing: it "
            "says nothing of right heights.",
        ),
    )


def _height(run: Reproduction, sample: PaperSample) -> ReportSection:
    rows = [row for published in (HEIGHT, HEIGHT_ERROR, FLATNESS) for row in _rows(run, sample, published)]
    rows.insert(3, _row(run, sample, "U (k = 2), µm", "height_u_um"))
    rows.append(_row(run, sample, "FLTq, µm", "flatness_rms_um"))
    rows.append(_row(run, sample, "Measured", "measured_fraction"))
    true_um = _value(run, sample, DEFAULT, "true_height_um")
    problems = (
        f"{method}: {text}"
        for method in METHODS
        if (figures := run.record(f"{sample.name}-{method}-figures", SurfaceFigures)) is not None
        for text in figures.problems.values()
    )
    return ReportSection(
        "Table 4 and Figure 6: height of the gauge blocks",
        table=_table(rows),
        sentences=(
            f"Between two areas of {sample.face_px} x {sample.face_px} pixels. The paper's blocks have a certified "
            f"height of {CERTIFIED_UM} µm; the same measurement on the true heights of the virtual ones gives "
            f"{_text(None) if true_um is None else number(true_um, 3)} µm, from which our error is.",
            "The paper does not define its flatness: ours is FLTt (ISO 12781), mean of both areas, and the ratio is no "
            "comparison.",
            *problems,
        ),
        figures=_pictures(run, sample),
    )


def _times(run: Reproduction, sample: PaperSample, title: str) -> ReportSection:
    rows = (row for published in TIMES[sample.name] for row in _rows(run, sample, published))
    return ReportSection(
        title,
        table=_table(rows),
        sentences=(
            f"{sample.rows} x {sample.cols} fields, {sample.n_frames} frames each. Acquisition is by the clock of the "
            "virtual rig, whose camera takes 60 frames a second; processing and stitching are by the clock of this "
            "machine, the paper's by that of its own; both work on several frames at once. Stitching includes the "
            "positions of the fields and the pyramid on the disk.",
        ),
    )


def _resources(run: Reproduction) -> ReportSection:
    """Return time, memory and bytes of every scan and surface."""
    rows = list[tuple[str, ...]]()
    for sample in run.samples:
        for step in ("scan", *(f"{method}-surface" for method in METHODS), "inspection"):
            record = run.record(f"{sample.name}-{step}", StepRecord if step != "inspection" else InspectionRecord)
            if record is None or not record.parts:
                continue
            spent_s = sum(part.seconds + part.stitching_s for part in record.parts)
            peak = max(part.peak_bytes for part in record.parts)
            title = f"{sample.name.replace('_', ' ')}, {step.removesuffix('-surface')}"
            rows.append((title, duration(spent_s), size(peak), size(record.bytes_made) if record.bytes_made else ""))
    return ReportSection(
        "Time, memory and bytes",
        table=Table(("Step", "Time", "Greatest memory", "Bytes on disk"), tuple(rows), " nnn"),
        sentences=(
            "Memory of all processes together, without mapped files. The time of a scan is that of the simulation, "
            "which draws every frame.",
            *_untimed(run),
        ),
    )


def _untimed(run: Reproduction) -> Iterator[str]:
    """Yield the steps of which a killed part was not timed."""
    for sample in run.samples:
        for step in ("scan", *(f"{method}-surface" for method in METHODS)):
            record = run.record(f"{sample.name}-{step}", StepRecord)
            timed = sum(part.frames for part in record.parts) if record else 0
            if record and timed < (total := sample.rows * sample.cols * sample.n_frames):
                yield f"{sample.name}, {step}: {timed} of {total} frames were timed, the others before it was killed."


# ------------------------------------------------------------------------------------------------------------- figures


def _pictures(run: Reproduction, sample: PaperSample) -> tuple[Figure, ...]:
    """Return the heights by every method: the measured ones of the default, and its filtered ones at the end."""
    asked = [*((method, "map") for method in MEASURES), (DEFAULT, "map_measured")]
    asked += [*((f"{method}{FILTERED}", "map") for method in MEASURES), (DEFAULT, "map")]
    low_um, high_um = sample.scene.z_min_um, sample.scene.z_max_um
    figures = list[Figure]()
    for method, layer in asked:
        spacing_um = _value(run, sample, method, "picture_um")
        if spacing_um is None:
            continue
        z_um = read_planes(run.arrays(sample, method))[layer]
        url = map_picture(_height_map(z_um, spacing_um), low_um, high_um, PICTURE_PX)
        what = f"{method}, measured heights" if layer == "map_measured" else method
        what = f"{method}, filtered heights" if (method, layer) == (DEFAULT, "map") else what
        figures.append(Figure(url, f"{what}; {number(low_um, 0)} (dark) to {with_unit(high_um, 0)}", small=True))
    return tuple(figures)


def _height_map(z_um: NDArray[np.float32], spacing_um: float) -> HeightMap:
    origin = np.where(np.isfinite(z_um), Origin.MEASURED, Origin.NO_REASON).astype(np.uint8)
    return HeightMap(z_um, z_um, np.ones_like(z_um), np.zeros_like(origin), origin, spacing_um, 0.0, 0.0)


def _cuts(run: Reproduction, sample: PaperSample) -> ReportSection:
    """Return the cuts along the paper's rows, with the shares of heights and of false ones by every method."""
    figures, rows = list[Figure](), list[tuple[str, ...]]()
    low_um, high_um = sample.scene.z_min_um, sample.scene.z_max_um
    margin_um = BEYOND * (high_um - low_um)
    ours = run.record(f"{sample.name}-{DEFAULT}-figures", SurfaceFigures)
    for n, title in enumerate(ours.cuts if ours is not None else ()):
        rows.append(_row(run, sample, f"{title}: with a height", f"cut{n}_fraction"))
        rows.append(_row(run, sample, "false", f"cut{n}_false_fraction"))
        planes = {name: read_planes(run.arrays(sample, name)) for name in DRAWN_CUTS if _done(run, sample, name)}
        curves = {name: (each[f"x{n}"], each[f"cut{n}"]) for name, each in planes.items()}
        curves["true"] = planes[DEFAULT][f"x{n}"], planes[DEFAULT][f"true{n}"]
        drawing = curves_svg(curves, (low_um - margin_um, high_um + margin_um))
        figures.append(Figure("", f"{title}; heights beyond the frame are drawn at its border", svg=drawing))
    return ReportSection(
        "Figure 8: profiles of the wafer",
        table=_table(rows),
        figures=tuple(figures),
        sentences=(
            "Rows of the mosaic by the paper's numbers, if it has as many, and at the same fractions of its height: "
            f"{', '.join(f'{part:.3f}' for part in SHARES_OF_THE_PAPER)}, the middle one moved into the gel drop.",
            FALSE,
        ),
    )


def _done(run: Reproduction, sample: PaperSample, method: str) -> bool:
    return run.record(f"{sample.name}-{method}-figures", SurfaceFigures) is not None


def _inspection(run: Reproduction, sample: PaperSample) -> ReportSection:
    found = run.record(f"{sample.name}-inspection", InspectionRecord)
    pairs: Pairs = ()
    if found is not None:
        kinds = ", ".join(f"{n} {kind}" for kind, n in sorted(found.kinds.items(), key=lambda item: -item[1]))
        pairs = (
            ("At the gel drop", found.at_drop or "nothing found"),
            ("Defects", kinds or "none"),
            ("Inspected", f"{found.inspected_mm2:.3g}\u202fmm²"),
            ("Compared with", found.reference),
        )
    reports = ", ".join(f"{each.name}-report.html" for each in run.samples)
    return ReportSection("Inspection of the wafer", pairs=pairs, empty="Not done.", sentences=(f"Reports: {reports}.",))


# ------------------------------------------------------------------------------------------------------------ Markdown


def markdown(report: Report) -> str:
    """Return the tables, pairs and sentences of a page as Markdown."""
    blocks = [f"# {report.title}", f"SIMULATED. {report.below[:1].upper()}{report.below[1:]}.", MADE_BY]
    for section in report.sections:
        if not (section.table or section.pairs or section.sentences):
            continue
        blocks += [f"## {section.title}", *section.sentences]
        table = section.table or (Table(("", ""), section.pairs) if section.pairs else None)
        if table is not None:
            lines = (table.heads, tuple("---" for _ in table.heads), *table.rows)
            blocks.append("\n".join(f"| {' | '.join(cell.replace('|', '/') for cell in line)} |" for line in lines))
    return "\n\n".join(blocks) + "\n"


MADE_BY = (
    "All of this page is made by `wafer-viewer paper FOLDER` (`--reduced` for minutes), which also writes it as one "
    "HTML file with the figures, `FOLDER/paper.html`."
)
