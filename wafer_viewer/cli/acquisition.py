"""Commands of the rig, its datasets and released jobs.

The signature of a command defines its flags, its docstring is its help.
"""

from __future__ import annotations

import signal
import socket
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Annotated

import msgspec
from tyro.conf import arg

from wafer_viewer.cli.arguments import (
    DATA_FOLDER,
    DatasetFolder,
    File,
    Folder,
    Folders,
    Integers,
    Numbers,
    Out,
    OutFile,
    PlanFile,
    Range,
    Text,
    Um,
    Us,
    config_of,
)
from wafer_viewer.cli.output import (
    audit,
    compile_for_frames,
    plan_facts,
    print_check,
    print_cluster,
    print_compilation,
    print_compression,
    print_conformance,
    print_digests,
    print_exposure,
    print_files,
    print_focus,
    print_json,
    print_lines,
    print_motion,
    print_passes,
    print_plan,
    print_positioners,
    print_preflight,
    print_result,
    print_running,
    print_storage,
    print_trial,
    print_verdict,
    progress,
    warn,
)
from wafer_viewer.model.errors import MotionStopped, PlanError, RigError
from wafer_viewer.model.spec import replace

if TYPE_CHECKING:
    from wafer_viewer.model.acquisition.devices import Rig
    from wafer_viewer.model.job import Job
    from wafer_viewer.session.planning.preflight import PreflightCheck


INTERRUPTED = 130
LAST_PORT = 65535


def serve(
    rig: File = None,
    data: Path = DATA_FOLDER,
    port: int = 8080,
    scheduler: Text = None,
    browse: Folders = (),
    open_browser: bool = False,
    new_token: bool = False,
    host: str = "127.0.0.1",
    certificate: File = None,
    certificate_key: File = None,
    password_file: File = None,
    new_password: bool = False,
) -> None:
    """Open the viewer; prints its address. Ctrl-C ends it.

    Other machines reach the page only with --host, which serves it by TLS and asks for a password.

    Args:
        rig: RIG.toml of the instrument; the virtual rig without it.
        data: Folder of the datasets; it is made when it is not there.
        port: Port of the page on this machine; 0 takes a free one.
        scheduler: Address of a dask cluster that runs already, tls://HOST:PORT; without it one is started here.
        browse: Folders that file dialogs may show, beside the data folder and the home folder.
        open_browser: Also open the page in the browser of this machine.
        new_token: Replace the token of the folder's address: addresses printed earlier no longer open the page.
        host: Address or name of this machine at which others reach the page; 0.0.0.0 for all of its networks.
        certificate: PEM file of the page's certificate; without it a self-signed one is made.
        certificate_key: PEM file of its key.
        password_file: Text file with the password, instead of one typed at the first start.
        new_password: Ask for another password; whoever logged in before has to log in again.
    """
    from wafer_viewer.compute.child_process import return_what_is_freed
    from wafer_viewer.gui.app import serve as serve_page
    from wafer_viewer.session.core.network_access import NetworkOptions, network_access
    from wafer_viewer.session.core.private_file import page_token
    from wafer_viewer.session.session import Session

    if not 0 <= port <= LAST_PORT:
        raise PlanError(f"--port is {port}: it must be between 0 and {LAST_PORT}; 0 takes a free one.")
    asked = NetworkOptions(host, certificate, certificate_key, password_file, new_password)
    network = network_access(data.expanduser(), asked)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    return_what_is_freed()
    session = Session(data.expanduser(), config_of(rig), scheduler, browse)
    try:
        print_compilation(session)
        token = page_token(session.snapshot.data_folder, renew=new_token or new_password)
        serve_page(session, host, port, open_browser=open_browser, token=token, network=network)
    finally:
        session.close()


def plan(plan_file: PlanFile, rig: File = None, json: bool = False) -> None:
    """Estimate the time of every strategy for a plan. Nothing moves.

    Args:
        plan_file: The plan.
        rig: RIG.toml of the instrument; the virtual rig without it.
        json: Print JSON instead of a table.
    """
    from wafer_viewer.session.planning.job_releases import read_job
    from wafer_viewer.session.planning.plan_editor import plan_of

    job = read_job(plan_file)
    with _opened(rig) as device:
        priced = plan_of(job, device.limits)
    print_json(plan_facts(priced)) if json else print_plan(priced)


def exposure(
    plan_file: PlanFile,
    rig: File = None,
    fields: Integers = (),
    write: bool = False,
    bracket: bool = False,
    json: bool = False,
) -> None:
    """Find the exposure of a plan, at which the brightest pixels in focus reach 80 % of white. The stage moves.

    It takes frames over the z range of the plan in some of its fields. Where one exposure leaves over 2 % of the pixels
    darker than 5 % of white, it proposes a bracket with figures.

    Args:
        plan_file: The plan.
        rig: RIG.toml of the instrument; the virtual rig without it.
        fields: Numbers of the fields to look at; up to five spread over the plan without it.
        write: Write the exposure into the plan.
        bracket: Take the proposed bracket instead of the single exposure, if there is one.
        json: Print JSON instead of sentences.
    """
    from wafer_viewer.session.acquisition.headless import find_exposure
    from wafer_viewer.session.acquisition.live_controller import write_exposures
    from wafer_viewer.session.planning.job_releases import read_job

    job = read_job(plan_file)
    with _opened(rig, for_frames=True) as device, progress("Exposure") as tell:
        found = find_exposure(job, device, fields, tell)
    taken_us = found.bracket_us if bracket and found.bracket else found.single_us
    if write:
        write_exposures(plan_file, taken_us)
    print_json(found) if json else print_exposure(found)
    if write and not json:
        print(f"{plan_file}: exposures_us = {', '.join(f'{us:g}' for us in taken_us)}")


def focus(
    rig: File = None,
    x_um: Um = None,
    y_um: Um = None,
    z_um: Um = None,
    z_range_um: Um = None,
    exposure_us: Us = None,
    highest_um: Um = None,
    json: bool = False,
) -> int:
    """Go to the focus at a place, and print its z with U (k = 2). The stage moves; Ctrl-C leaves the rig at rest.

    Args:
        rig: RIG.toml of the instrument; the virtual rig without it.
        x_um: Place on the stage; where it stands by default.
        y_um: Place on the stage; where it stands by default.
        z_um: Middle of the search; where the stage stands by default.
        z_range_um: Range of z that is searched; six depths of field to either side by default, and farther if need be.
        exposure_us: Exposure; found by itself by default.
        highest_um: Highest z of the sample, which the objective stays clear of; the middle of the search by default.
        json: Print JSON, with the scores over z, instead of a sentence.
    """
    from wafer_viewer.session.acquisition.headless import go_to_focus

    place = {"x_um": x_um, "y_um": y_um, "z_um": z_um, "z_range_um": z_range_um, "highest_um": highest_um}
    try:
        with _opened(rig, for_frames=True) as device, progress("Focus") as tell:
            found = go_to_focus(device, **place, exposure_us=exposure_us, progress=tell)
    except MotionStopped as stop:
        print(f"{stop} The rig is at rest.")
        return INTERRUPTED
    print_json(found) if json else print_focus(found)
    return 0


def scan(
    plan_file: PlanFile,
    out: Out,
    rig: File = None,
    wafer: Text = None,
    lot: Text = None,
    operator: Text = None,
    corners: Numbers = (),
    compress: Text = None,
    yes: bool = False,
) -> int:
    """Scan without the browser. An unfinished dataset of the same plan is continued. Ctrl-C stops the rig.

    Prints the checks before the start; one that forbids the scan ends it there. A released job continues to the surface
    and the verdict: status 0 is pass, 1 any other verdict.

    Args:
        plan_file: The plan, or a released job.
        out: The dataset, NAME.wafer.
        rig: RIG.toml of the instrument; the virtual rig without it.
        wafer: Id of the wafer.
        lot: Its lot.
        operator: Who scans it; where people are listed, one of them, who gives a password.
        corners: Where on the stage each corner was seen that the job aligns by, x and y, in the job's order.
        compress: Compress the frames without loss at the end: zstd, deflate or jpeg2000; as the plan says by default.
        yes: Start although something is not as it should be, as long as nothing forbids the scan.
    """
    from wafer_viewer.session.acquisition.headless import scan_to
    from wafer_viewer.session.core.people import acting_person, name_of, role_of
    from wafer_viewer.session.planning.job_releases import require_released
    from wafer_viewer.session.planning.preflight import require_passed
    from wafer_viewer.session.planning.revision_trial import job_of_wafer

    folder = out.absolute().parent
    person = acting_person(folder, "Scan made", operator, "--operator")
    operator = operator if person is None else person.name
    job = job_of_wafer(plan_file, out, {"wafer_id": wafer, "lot": lot, "operator": operator}, corners)
    if role_of(person) == "operator":
        require_released(folder, job, f"{operator} is listed as operator.")
    if compress is not None:
        job = replace(job, compression=compress)

    def ready(checks: tuple[PreflightCheck, ...]) -> None:
        print_preflight(checks)
        require_passed(checks, confirmed=yes)

    with _opened(rig, for_frames=True) as device, progress("Scan") as tell:
        ended = scan_to(out, job, device, tell, ready, warn)
    if ended.error is not None:
        raise RigError(ended.error)
    print(f"{out}: {ended.words}")
    audit(folder, "Scan made", out.name, ended.words, by=name_of(person, operator))
    if ended.stopped:
        return INTERRUPTED
    status = _judged(out, job) if job.released else 0
    return status if job.compression == "none" else max(status, _compressed(out, job.compression))


def _judged(out: Path, job: Job) -> int:
    """Reconstruct the surface of a released job, print its verdict, and return the exit status."""
    from wafer_viewer.session.planning.revision_trial import stored_verdict_of
    from wafer_viewer.session.surface.headless import make_surface

    with progress("Surface") as tell:
        make_surface(out, job.recipe, "default", again=False, tell=tell, warn=warn)
    return print_verdict(stored_verdict_of(out, "default"))


def check(dataset: DatasetFolder) -> int:
    """Test every checksum of a dataset and name missing frames; status 1 when something is damaged or missing.

    All files that a number depends on are read: frames, scan record, journal, surfaces, poses, recipes, results; and
    the signed logs beside the dataset. Verdicts and gauge checks are derived again from their numbers.
    Also checks the passes of a scan against the counts of the pulse box and the times of their frames.

    Args:
        dataset: The dataset.
    """
    from wafer_viewer.model.errors import DatasetError
    from wafer_viewer.session.reporting.record_check import check_records
    from wafer_viewer.store.dataset.dataset import Dataset, check_passes
    from wafer_viewer.store.dataset.integrity import check_files, digests_of_result, digests_of_scan

    with progress("Check") as tell:
        try:
            data = Dataset.open(dataset)
        except DatasetError:
            files = check_files(dataset, tell)
            if not any(kind.damaged for kind in files):
                raise
            print_files(files)
            return 1
        report = data.check(tell)
    print_files(report.files)
    print_check(data, report)
    if data.scan.is_compressed:
        print_storage(data)
    passes = check_passes(data)
    if passes.n_passes or passes.noted:
        print_passes(passes)
    print_digests(digests_of_scan(dataset))
    for name in data.results():
        print_digests(digests_of_result(data.result(name)))
    records = check_records(data)
    print_lines((*records.logs, *records.faults))
    return 0 if report.ok and passes.ok and not records.faults else 1


def compress(dataset: DatasetFolder, codec: str = "zstd") -> int:
    """Make the frames of a dataset smaller without loss; status 1 when a file was left because a frame is damaged.

    Every new file is read back and compared with the checksums of the scan before it replaces the old one. Ctrl-C stops
    it; started again it continues. Heights stay the same, to the bit.

    Args:
        dataset: The dataset; nothing may be scanning into it.
        codec: zstd is read fastest, jpeg2000 is smallest and slow, deflate opens in most programs; none undoes it.
    """
    return _compressed(dataset, codec)


def _compressed(dataset: Path, codec: str) -> int:
    """Compress the frames of a dataset, print the sizes, and return the exit status."""
    from wafer_viewer.store.dataset.dataset import Dataset

    data = Dataset.open(dataset)
    with progress("Compress") as tell:
        report = data.compress(codec, tell)
    print_storage(data)
    print_compression(report)
    return 1 if report.left else 0


def cluster(folder: Folder, host: Text = None) -> None:
    """Make what machines need to work together: certificates and dask's configuration. Prints the lines to run.

    Args:
        folder: A new folder; whoever has a copy can run code on the machines of the cluster.
        host: Name or address of the machine that shares out the work; this one without it.
    """
    from wafer_viewer.compute.cluster_credentials import write_cluster_files

    write_cluster_files(folder)
    print_cluster(folder.absolute(), host or socket.gethostname())


def positioners(rig: File = None, move: Annotated[tuple[str, ...], arg(metavar="NAME=POSITION ...")] = ()) -> None:
    """List light, objective, zoom, tilts and rotation of a rig with their positions and ranges; move them.

    z goes to the safe z before an objective, a tilt or the rotation turns. Ctrl-C stops the rig.

    Args:
        rig: RIG.toml of the instrument; the virtual rig without it.
        move: Positions to go to, in this order, as numbers or by name, such as lamp=40 nosepiece=20x.
    """
    from wafer_viewer.session.acquisition.headless import move_positioners

    goals = [(name.strip(), to.strip()) for name, _, to in (text.partition("=") for text in move)]
    if any(not (name and to) for name, to in goals):
        raise RigError(f"--move is '{' '.join(move)}': it must be NAME=POSITION, such as lamp=40.")
    with _opened(rig) as device:
        print_positioners(move_positioners(device, goals))


def conformance(
    rig: File = None,
    out: OutFile = None,
    move: bool = False,
    travel_um: Um = None,
    z_um: Range | None = None,
    by: str = "",
    data: Path = DATA_FOLDER,
    verify: File = None,
    key: Text = None,
) -> int:
    """Check on the rig itself that it does what a scan needs, with a signed report; status 1 when a check fails.

    Nothing moves without --move. Before anything moves it says which axes move, and how far. Ctrl-C stops the stage and
    leaves the rig at rest. With --verify it opens no rig and says whether a report was altered since it was signed.

    Args:
        rig: RIG.toml of the instrument; the virtual rig without it.
        out: The report, NAME.html; NAME.json with all figures lies beside it. None is written without it.
        move: Home the stage if need be and move every axis, also at full speed. Clear the way first.
        travel_um: Longest motion of x and y; as much as their full speed needs by default.
        z_um: Range of z; by default below where it stands, away from the objective.
        by: Lab or person, for the report.
        data: Folder of the datasets; the key that signs reports lies in it.
        verify: A report to verify, NAME.html or NAME.json.
        key: With --verify, the public key of the lab that has to have signed it.
    """
    if verify is not None:
        return _verified(verify, key or "", data.expanduser())
    from wafer_viewer.session.acquisition.headless import check_conformance, interrupt_stops
    from wafer_viewer.store.records.conformance_reports import report_paths

    if out is not None:
        report_paths(out)  # refuses a wrong name before the rig is opened
    stopped = Event()
    with interrupt_stops(stopped.set):
        report = check_conformance(
            config_of(rig),
            move=move,
            longest_um=travel_um,
            z_um=z_um,
            by=by,
            rig_file="" if rig is None else rig.name,
            tell=print_motion,
            begin=print_running,
            done=print_result,
            should_stop=stopped.is_set,
        )
    print_conformance(report)
    if out is not None:
        from wafer_viewer.session.reporting.conformance_report import write_conformance

        print(*write_conformance(report, out, data.expanduser()), sep="\n")
    return INTERRUPTED if stopped.is_set() else int(report.counts["failed"] > 0)


def _verified(report: Path, key: str, data: Path) -> int:
    """Verify a report and print what its signature shows."""
    from wafer_viewer.session.reporting.conformance_report import own_key, verify_conformance

    found = verify_conformance(report, key)
    print_conformance(found.report)
    whose = "of this data folder" if found.key == own_key(data) else "of another data folder"
    print(f"{report}: not altered since it was signed with the key {found.key}, {whose}")
    return 0


@contextmanager
def _opened(rig: Path | None, *, for_frames: bool = False) -> Generator[Rig]:
    """Open the rig, ready to take frames if these are wanted, and close it at the end."""
    from wafer_viewer.rigs.rig_config import open_rig

    device = open_rig(config_of(rig))
    try:
        if for_frames:
            compile_for_frames(device)
        yield device
    finally:
        device.close()


def release(
    plan_file: PlanFile,
    good: File = None,
    product: Text = None,
    revision: Text = None,
    result: str = "default",
    data: Path = Path("~/wafer-viewer"),
    against: Annotated[tuple[Path, ...], arg(metavar="DATASET|FOLDER ...")] = (),
    by: Text = None,
    reason: str = "",
    dry_run: bool = False,
) -> None:
    """Release a plan as a job that operators run with four actions; prints its file. A revision is never overwritten.

    The plan names corners to align by, and features with their places and limits. Tried against stored datasets before,
    it says which verdicts change, and why; a changed recipe makes their surfaces again, beside the existing ones.

    Args:
        plan_file: The plan, or a released job to make another revision of.
        good: A stitched NAME.wafer of a good sample that settles what is 'auto'; a job without 'auto' needs none.
        product: Name of the product, where the plan has none.
        revision: The revision, where the plan has none.
        result: Name of the reconstruction.
        data: Folder of the datasets; released jobs lie in its folder jobs.
        against: Stored datasets, or folders of them, to try it on before it is released.
        by: Engineer who releases it, where people are listed; the account without it.
        reason: What the job is for, or what changed, for the audit log; needed where people are listed.
        dry_run: Only say what would change; release nothing.
    """
    from wafer_viewer.session.core.people import acting_person, name_of, require_reason
    from wafer_viewer.session.planning.job_releases import write_released
    from wafer_viewer.session.planning.revision_trial import job_to_release, tried

    names, folder = {"product": product, "revision": revision}, data.expanduser()
    person = None if dry_run else acting_person(folder, "Job released", by)
    require_reason(person, reason)
    job = job_to_release(plan_file, names, good, result, folder)
    if against:
        with progress("Judging stored datasets") as tell:
            trial = tried(job, against, result, tell)
        print_trial(trial)
    if not dry_run:
        path = write_released(folder, job)
        print(path)
        why = f"why: {' '.join(reason.split())}" if reason.strip() else ""
        audit(folder, "Job released", path.name, why, by=name_of(person, by), wrote=path)


def measure_verdict(dataset: DatasetFolder, result: str = "default") -> int:
    """The verdict on a wafer by the features of its job, as JSON; status 0 is pass, 1 any other verdict.

    Args:
        dataset: The dataset, stitched.
        result: Name of the reconstruction.
    """
    from wafer_viewer.session.planning.revision_trial import stored_verdict_of

    verdict = stored_verdict_of(dataset, result)
    print_json(msgspec.to_builtins(verdict))
    return 0 if verdict.word == "pass" else 1
