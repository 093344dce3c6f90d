"""Output of the commands: results on standard output, progress on standard error."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Generator, Iterable
from contextlib import contextmanager
from itertools import groupby
from typing import TYPE_CHECKING, Any

import msgspec
from rich.console import Console
from rich.table import Table
from rich.text import Text

from wafer_viewer.draw.number_format import value_and_u
from wafer_viewer.model.acquisition.plan import Price, ScanPlan
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.measurement.feature import limits_text
from wafer_viewer.model.progress import Progress
from wafer_viewer.store.io.atomic_files import size

if TYPE_CHECKING:
    from pathlib import Path

    from wafer_viewer.acquire.conformance.bench import ConformanceCheck
    from wafer_viewer.acquire.focus.search import FocusedPlace
    from wafer_viewer.model.acquisition.conformance import ConformanceReport, ConformanceResult
    from wafer_viewer.model.acquisition.devices import Rig
    from wafer_viewer.model.acquisition.positioners import PositionerState
    from wafer_viewer.model.acquisition.procedure import FoundExposure
    from wafer_viewer.model.file_contents import FileContents
    from wafer_viewer.model.gauge import GaugeRR, ProcessCapability
    from wafer_viewer.model.inspection.lot import StatisticsRow
    from wafer_viewer.model.job import Trial, WaferVerdict
    from wafer_viewer.model.quantity import Quantity
    from wafer_viewer.model.roles import Action, AuditEntry
    from wafer_viewer.session.core.environment_check import EnvironmentCheck
    from wafer_viewer.session.planning.preflight import PreflightCheck
    from wafer_viewer.session.session import Session
    from wafer_viewer.session.state.snapshot import DatasetEntry, KernelProgress, Snapshot, SurfaceInfo
    from wafer_viewer.store.dataset.compression import CompressionReport
    from wafer_viewer.store.dataset.dataset import CheckReport, Dataset, PassReport
    from wafer_viewer.store.dataset.integrity import Digest, KindReport

NAMED = 20
"""Maximum number of missing or damaged frames that are listed."""


def print_json(facts: Any) -> None:
    """Print facts as JSON on standard output."""
    print(msgspec.json.format(msgspec.json.encode(facts), indent=2).decode())


def to_program(json: bool) -> bool:
    """Return whether a result is printed as JSON: into a pipe or a file, and where it is asked for."""
    return json or not sys.stdout.isatty()


def print_capability(name: str, found: ProcessCapability) -> None:
    """Print Cp and Cpk with their confidence limits, and the parts beyond the limits."""
    low, high = found.cpk_limits
    print(f"{name}: {found.word.upper()}, Cpk {found.cpk:.2f} ({low:.2f} to {high:.2f}, 95 %)")
    if found.cp is not None and found.cp_limits is not None:
        print(f"  Cp {found.cp:.2f} ({found.cp_limits.low:.2f} to {found.cp_limits.high:.2f}, 95 %)")
    print(f"  {found.n} parts, mean {found.mean:.6g}, s {found.s:.3g}")
    print(f"  {found.beyond} beyond the limits; {1e6 * found.expected_beyond:.3g} in a million expected, if normal")


def print_study(name: str, found: GaugeRR) -> None:
    """Print a gauge R&R study: verdict, standard deviations with their limits, and the analysis of variance."""
    print(f"{name}: {found.parts} parts x {found.appraisers} appraisers x {found.trials} trials, by {found.method}")
    print(f"{(found.word or 'no verdict').upper()}: {found.why}")
    table = Table("", "s", "95 % limits", "of total", box=None, pad_edge=False)
    for title, s, limits in found.deviations:
        part = f"{100 * s / found.total_variation:.1f} %" if found.total_variation else ""
        table.add_row(title, f"{s:.4g}", "" if limits is None else f"{limits.low:.4g} to {limits.high:.4g}", part)
    console = Console(soft_wrap=True)
    console.print(table)
    if found.anova:
        table = Table("Effect", "Freedom", "Sum of squares", "Mean square", "F", "p", box=None, pad_edge=False)
        for row in found.anova:
            f, p = ("" if number is None else f"{number:.4g}" for number in (row.f, row.p))
            squares = f"{row.sum_of_squares:.6g}", f"{row.mean_square:.6g}"
            table.add_row(row.effect, str(row.freedom), *squares, f, p)
        console.print(table)
    for note in found.notes:
        print(note)


def print_statistics(rows: Iterable[StatisticsRow]) -> None:
    """Print the rows of a lot, with a line before each table."""
    from wafer_viewer.session.reporting.lot_report import HEADS, row_cells

    console = Console(soft_wrap=True)
    for name, group in groupby(rows, key=lambda row: row.table):
        table = Table(*HEADS, box=None, pad_edge=False, title=name.capitalize(), title_justify="left")
        for row in group:
            table.add_row(*map(Text, row_cells(row)))
        console.print(table)


def print_plan(plan: ScanPlan) -> None:
    """Print the strategies with their predicted times, the chosen one marked, and the totals of the scan."""
    table = Table("", "Strategy", "Frames", "Time, s", "Motions", "", box=None, pad_edge=False)
    for price in plan.prices:
        chosen = "*" if price.strategy == plan.strategy else ""
        seconds = "" if price.predicted_s is None else f"{price.predicted_s:.1f}"
        table.add_row(chosen, price.title, str(price.n_frames or ""), seconds, str(price.motions or ""), _remark(price))
    Console(soft_wrap=True).print(table)
    print(
        f"{len(plan.fields)} fields, {plan.frames_each} frames each, {plan.n_frames} in all; "
        f"{plan.predicted_s:.1f} s, {plan.bytes_on_disk / 1e9:.2f} GB on disk"
    )


def _remark(price: Price) -> str:
    """Return the reason against a strategy, or the coarse look in its price."""
    if price.ruled_out is not None or not price.look_s:
        return price.ruled_out or ""
    return f"with {price.look_s:.1f} s of coarse look{', estimated' if price.estimated else ''}"


def print_exposure(found: FoundExposure) -> None:
    """Print the exposure found with the brightness in focus, what was looked at, and the bracket if one is proposed."""
    single, fields = found.single, ", ".join(map(str, found.fields))
    print(
        f"{single.exposure_us:g} us: the brightest pixels in focus reach {single.level:.0%} of white, in field "
        f"{single.brightest_field}; {single.dark_fraction:.1%} of the pixels are under 5 % of white"
    )
    print(
        f"Fields {fields}, {len(found.z_um)} positions over {found.z_um[-1]:g} um in z; {found.n_frames} frames in all"
    )
    if not found.bracket:
        return
    table = Table("Exposure, us", "Clipped", "Under 5 % of white", box=None, pad_edge=False)
    for levels in found.bracket:
        table.add_row(f"{levels.exposure_us:g}", f"{levels.clipped_fraction:.1%}", f"{levels.dark_fraction:.1%}")
    print("A bracket brings more pixels to light; take it with --bracket:")
    Console(soft_wrap=True).print(table)


def print_focus(found: FocusedPlace) -> None:
    """Print the z of the focus with its expanded uncertainty, the place, and the exposure."""
    z, u = value_and_u(found.focus.z_um, 2 * found.focus.u_um)
    print(
        f"z {z} um, U = {u} um (k = 2, of the fit) at x {found.x_um:.1f}, y {found.y_um:.1f} um; "
        f"{len(found.focus.curve)} frames of {found.exposure_us:g} us. The stage stands there."
    )


def plan_facts(plan: ScanPlan) -> dict[str, Any]:
    """Return the summary of a plan with its strategies, without its path."""
    return {
        "strategy": plan.strategy,
        "predicted_s": plan.predicted_s,
        "n_fields": len(plan.fields),
        "n_frames": plan.n_frames,
        "bytes_on_disk": plan.bytes_on_disk,
        "prices": msgspec.to_builtins(plan.prices),
    }


def print_preflight(checks: Iterable[PreflightCheck]) -> None:
    """Print the checks made before a scan."""
    for check in checks:
        print(f"{check.state:<9} {check.what}: {check.found} {check.mend}".rstrip(), flush=True)


def print_verdict(verdict: WaferVerdict) -> int:
    """Print every feature, the verdict and the next action; return 0 for a pass, 1 for any other verdict."""
    for item in verdict.items:
        limits = limits_text(item.feature)
        print(f"{item.word.upper():<12} {item.name}: {measured_text(item.measured)}, limits {limits}. {item.why}")
    if verdict.dies:
        dies = "1 die" if len(verdict.dies) == 1 else f"{len(verdict.dies)} dies"
        print(f"{dies}: {', '.join(f'{n} {word}' for word, n in verdict.die_counts.items())}")
    simulated = " SIMULATED" if verdict.simulated else ""
    print(f"{verdict.word.upper()}{simulated}: {verdict.next}")
    return 0 if verdict.word == "pass" else 1


def print_trial(trial: Trial) -> None:
    """Print every changed verdict with its reasons, the datasets that were not judged, and the totals."""
    for wafer in trial.wafers:
        words = f"{_word(wafer.before)} -> {_word(wafer.after)}" if wafer.before != wafer.after else _word(wafer.after)
        same = f"{wafer.n_same} feature{'' if wafer.n_same == 1 else 's'} as before"
        print(f"{wafer.dataset}: {words}, {same}, judged on {wafer.result}")
        for change in wafer.changes:
            measured = f"{measured_text(change.measured_before)}; {measured_text(change.measured_after)}"
            print(f"  {change.feature}: {_word(change.before)} -> {_word(change.after)} ({measured})")
            print(f"    {' '.join(change.why)}")
    for left_out in trial.not_tried:
        print(f"{left_out.dataset}: not judged. {left_out.why}")
    print(f"{trial.job}: {trial.summary}")


def _word(word: str | None) -> str:
    return "not judged" if word is None else word.upper()


def measured_text(measured: Quantity | None) -> str:
    """Return a value with its expanded uncertainty in ASCII."""
    if measured is None:
        return "not measured"
    u, unit = measured.expanded, measured.unit
    plus_minus = f" +- {u:.2g} {unit} ({measured.k_text})" if u is not None else ", no uncertainty"
    return f"{measured.value:.3f} {unit}{plus_minus}"


def print_surface(out: Path, info: SurfaceInfo) -> None:
    """Print the file, the measured and filled shares, the reasons for unmeasured points, and the notes."""
    print(out)
    print(f"{info.measured_fraction:.1%} measured, {info.filled_fraction:.1%} filled")
    for reason, share in info.unmeasured:
        print(f"  {share:.1%} {reason}")
    for note in info.recipe_notes:
        print(f"  {note}")


def print_contents(found: FileContents) -> None:
    """Print what a source holds: facts with their sources, the frames in order with their z, notes and doubts."""
    print(f"{found.name}: {found.kind}")
    width = max((len(fact.name) for fact in found.facts), default=0)
    for fact in found.facts:
        print(f"  {fact.name:<{width}}  {fact.value or 'unknown'}" + (f"  ({fact.source})" if fact.source else ""))
    shown = found.frames if len(found.frames) <= 2 * NAMED else (*found.frames[:NAMED], *found.frames[-NAMED:])
    for n, frame in enumerate(shown):
        if n == NAMED and len(shown) < len(found.frames):
            print(f"  ... {len(found.frames) - len(shown)} more")
        z = "" if frame.z_um is None else f"  {frame.z_um:g} um"
        print(f"  {frame.name or 'missing'}{z}")
    for note in found.notes:
        print(f"Note: {note}")
    for doubt in found.doubts:
        print(f"To settle: {doubt}")
    if found.can_import and found.kind != "dataset":
        print("stitch-images makes one picture of it." if found.is_tiled else "It can be imported as it is.")


def print_files(kinds: Iterable[KindReport]) -> None:
    """Print a line per kind of file with the states of its checksums, and a line per damaged file."""
    for kind in kinds:
        counts = (f"{kind.n_good} good",) if kind.n_good else ()
        counts += (f"{len(kind.damaged)} damaged",) if kind.damaged else ()
        counts += (f"{kind.n_without} {_without_checksum(kind.title)}",) if kind.n_without else ()
        print(f"{kind.title}: {', '.join(counts)}")
        for fault in kind.damaged[:NAMED]:
            print(f"  {fault}")
        if len(kind.damaged) > NAMED:
            print(f"  and {len(kind.damaged) - NAMED} more")


def _without_checksum(title: str) -> str:
    from wafer_viewer.store.dataset.integrity import UNKNOWN

    return "of no kind that Wafer Viewer writes" if title == UNKNOWN else "without a checksum"


def print_check(data: Dataset, report: CheckReport) -> None:
    """Print the number of good frames, and the missing and damaged ones."""
    print(f"{data.path}: {report.n_good} frames good, {len(report.missing)} missing, {len(report.damaged)} damaged")
    if data.removed is not None:
        print(f"  {data.removed.sentence(data.path.name)} {report.n_removed} files; none of them is lost.")
    if data.held is not None:
        print(f"  held by {data.held.by} since {data.held.time[:10]}: {data.held.why}")
    for what, shots in (("missing", report.missing), ("damaged", report.damaged)):
        for shot in shots[:NAMED]:
            print(f"  {what}: field {shot.field}, frame {shot.k}, exposure {shot.exposure}")
        if len(shots) > NAMED:
            print(f"  {what}: and {len(shots) - NAMED} more")
    if report.damaged:
        from wafer_viewer.store.dataset.scan_record import frames_file
        from wafer_viewer.store.io.checksums import remedy

        print(f"  mend: {remedy(frames_file(data.path, data.field(report.damaged[0].field)))}")
    for fault in report.faults:
        print(f"  {fault}")


def print_datasets(entries: Iterable[DatasetEntry]) -> None:
    """Print one dataset a line."""
    table = Table("Dataset", "Taken", "Lot", "Wafer", "Product", "Verdict", "", box=None, pad_edge=False)
    for entry in entries:
        signs = [word for word, yes in (("unfinished", entry.unfinished), ("SIMULATED", entry.simulated)) if yes]
        words = (entry.path.name, entry.taken[:16].replace("T", " "), entry.lot, entry.wafer_id, entry.product)
        table.add_row(*(Text(word) for word in (*words, entry.verdict, ", ".join(signs))))
    Console(soft_wrap=True).print(table)


def print_audit(entries: Iterable[AuditEntry]) -> None:
    """Print who did what, one action a line."""
    table = Table("Time, UTC", "Who", "Through", "Action", "Of", "", box=None, pad_edge=False)
    for entry in entries:
        at = entry.at.removesuffix("+00:00").replace("T", " ")
        words = (at, entry.by, entry.through, entry.action, entry.subject, entry.detail)
        table.add_row(*(Text(word) for word in words))
    Console(soft_wrap=True).print(table)


def audit(
    folder: Path, action: Action, subject: str, detail: str = "", *, by: str = "", wrote: Path | None = None
) -> None:
    """Record what a command did in the audit log of a data folder; warn when it cannot be: the work is done."""
    from wafer_viewer.session.core.audit_trail import NOT_WRITTEN, record

    try:
        record(folder, action, subject, detail, by=by, wrote=wrote)
    except DatasetError as fault:
        warn(f"{NOT_WRITTEN}, {action}, {subject}: {fault}")


def print_lines(lines: Iterable[str]) -> None:
    """Print sentences, one a line."""
    for line in lines:
        print(line)


def print_storage(data: Dataset) -> None:
    """Print the size of the frames on disk, and how many times smaller they are than uncompressed."""
    stored = data.frame_bytes()
    raw = sum(data.scan.pages(field).file_bytes for field in data.fields)
    print(f"{data.path}: the frames take {size(stored)}, {size(raw)} uncompressed: {raw / max(1, stored):.2f} to 1")


def print_compression(report: CompressionReport) -> None:
    """Print the number of files that changed, and one line for each that was left as it was."""
    files = "1 file" if report.n_changed == 1 else f"{report.n_changed} files"
    print(f"{files} changed, {len(report.left) or 'none'} left as before")
    for fault in report.left:
        print(f"  {fault}")


def print_passes(report: PassReport) -> None:
    """Print whether counts and times of the passes match their frames, and the notes of the scan."""
    print(
        f"{report.n_passes} passes checked against the counts of the pulse box, {report.n_timed} of them against the "
        f"times of their frames: {len(report.doubts) or 'none'} in doubt"
    )
    for doubt in report.doubts:
        print(f"  {doubt}")
    for what in report.noted:
        print(f"  noted during the scan: {what}")


def print_digests(digests: Iterable[Digest]) -> None:
    """Print the checksums to compare with those on reports."""
    for digest in digests:
        print(f"  {digest.sha256}  {digest.what}: {digest.of}")


def print_checks(checks: Iterable[EnvironmentCheck]) -> int:
    """Print one line per check, and how to fix a failed one; return 1 if any failed, else 0."""
    status = 0
    for check in checks:
        print(f"{'ok  ' if check.well else 'LACK'} {check.what}: {check.found}", flush=True)
        if not check.well:
            print(f"     mend: {check.mend}")
            status = 1
    return status


def print_positioners(states: Iterable[PositionerState]) -> None:
    """Print one line per positioner: name, title, position, range and named positions."""
    for state in states:
        print(f"{state.reading.name}: {state.words}")


def print_motion(sentence: str) -> None:
    """Print a motion before it begins."""
    print(f"MOVES     {sentence}", flush=True)


def print_running(check: ConformanceCheck) -> None:
    """Show on a terminal which check is running."""
    if sys.stderr.isatty():
        print(f"running   {check.name}: {check.title} ...", end="\r", file=sys.stderr, flush=True)


def print_result(result: ConformanceResult) -> None:
    """Print a check with its figures, and the reason where it did not pass."""
    figures = "; ".join(figure.text for figure in result.figures)
    print(f"{result.verdict:<9} {result.name}: {' '.join(part for part in (result.why, figures) if part)}", flush=True)


def print_conformance(report: ConformanceReport) -> None:
    """Print the rig, its devices, and the number of checks with each verdict."""
    for device in report.devices:
        print(f"{device.role}: {device.identity} (driver {device.driver})")
    simulated = "SIMULATED, " if report.simulated else ""
    print(f"{report.rig}, {report.at}, Wafer Viewer {report.program_version}: {simulated}{report.summary}")


def print_cluster(folder: Path, host: str) -> None:
    """Print the commands to run on each machine of a cluster."""
    prefix = f"cd {shlex.quote(str(folder))} && DASK_CONFIG=."
    ours = f"DASK_CONFIG={shlex.quote(str(folder))} wafer-viewer"
    closed = "--dashboard-address 127.0.0.1:0"
    print(rf"""{folder} has the cluster's certificates. Copy it to every machine, wherever it fits there, and keep it
secret: whoever has it can run code on them. On {host}, which shares out the work:
  {prefix} dask scheduler {closed}
On every machine that works, with as many workers as it has processors and 3 GiB for each:
  {prefix} dask worker tls://{host}:8786 --nworkers 2 --nthreads 1 --memory-limit 3GiB \
    --preload-nanny wafer_viewer.compute.dask_worker {closed}
Where the viewer or the command line runs:
  {ours} serve --scheduler tls://{host}:8786
  {ours} stitch NAME.wafer --scheduler tls://{host}:8786
Datasets lie in a folder that all machines share under the same path; the same wafer-viewer is installed on all.""")


def warn(sentence: str) -> None:
    """Print a warning on standard error."""
    print(f"wafer-viewer: {' '.join(sentence.split())}", file=sys.stderr, flush=True)


def compile_for_frames(rig: Rig) -> None:
    """Compile the kernels of simulated frames, with lines about it on standard error; a real rig needs none."""
    if rig.simulated:
        from wafer_viewer.session.surface.kernel_build import SIMULATION, compile_missing

        compile_missing(SIMULATION, lambda progress: warn(f"{progress.words}."))


def print_compilation(session: Session) -> None:
    """Print the progress of a session's compilation of the kernels, and its end; nothing if they are compiled."""
    printed: KernelProgress | None = None

    def look(now: Snapshot) -> None:
        nonlocal printed
        if now.kernels != printed:
            printed = now.kernels
            print("The compilation of the kernels has ended." if printed is None else f"{printed.words}.", flush=True)

    session.subscribe(look)
    look(session.snapshot)


@contextmanager
def progress(what: str) -> Generator[Progress]:
    """Show a progress bar on standard error if it is a terminal; yield the callback that sets it, 0 to 1."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda fraction: None
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:3.0f} %"))
    with Progress(*columns, TimeRemainingColumn(), console=console, transient=True) as bar:
        task = bar.add_task(what, total=1.0)
        yield lambda fraction: bar.update(task, completed=fraction)
