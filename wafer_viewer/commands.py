"""What each command does. A function's signature is the command's flags, its docstring the command's help."""

from __future__ import annotations

import signal
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import msgspec
from tyro.conf import Positional, arg

from wafer_viewer.command_output import plan_facts, print_check, print_checks, print_json, print_plan, progress
from wafer_viewer.model.errors import DatasetError, PlanError, RigError
from wafer_viewer.model.recipe import Recipe
from wafer_viewer.model.region import Region

if TYPE_CHECKING:
    from wafer_viewer.model.devices import Rig
    from wafer_viewer.rigs.config import RigConfig

PlanFile = Annotated[Positional[Path], arg(metavar="PLAN.toml")]
DatasetFolder = Annotated[Positional[Path], arg(metavar="NAME.wafer")]
Source = Annotated[Positional[Path], arg(metavar="SRC")]
Sources = Annotated[Positional[tuple[Path, ...]], arg(metavar="SRC ...")]
Out = Annotated[Path, arg(aliases=("-o",), metavar="FILE")]
Um = Annotated[float | None, arg(metavar="UM")]
File = Annotated[Path | None, arg(metavar="FILE")]
Text = Annotated[str | None, arg(metavar="TEXT")]
Rectangle = Annotated[tuple[float, float, float, float], arg(metavar="X0 Y0 X1 Y1")]
DATA_FOLDER = Path("~/wafer-viewer")
INTERRUPTED = 130
LAST_PORT = 65535


def serve(
    rig: File = None,
    data: Path = DATA_FOLDER,
    port: int = 8080,
    scheduler: Text = None,
    open_browser: bool = False,
) -> None:
    """Open the viewer; prints its address. Ctrl-C ends it.

    Args:
        rig: RIG.toml of the instrument; the virtual rig without it.
        data: Folder of the datasets; it is made when it is not there.
        port: Port of the page on this machine; 0 takes a free one.
        scheduler: Address of a dask cluster that runs already, tls://HOST:PORT; without it one is started here.
        open_browser: Also open the page in the browser of this machine.
    """
    from wafer_viewer.gui.app import serve as serve_page
    from wafer_viewer.session.session import Session

    if not 0 <= port <= LAST_PORT:
        raise PlanError(f"--port is {port}: it must be between 0 and {LAST_PORT}; 0 takes a free one.")
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    session = Session(data.expanduser(), _config(rig), scheduler)
    try:
        serve_page(session, port=port, open_browser=open_browser)
    finally:
        session.close()


def plan(plan_file: PlanFile, rig: File = None, json: bool = False) -> None:
    """Price every strategy for a plan. Nothing moves.

    Args:
        plan_file: The plan.
        rig: RIG.toml of the instrument; the virtual rig without it.
        json: Print JSON instead of a table.
    """
    from wafer_viewer.session.drafting import plan_of, read_job

    job = read_job(plan_file)
    with _opened(rig) as device:
        priced = plan_of(job, device.limits)
    print_json(plan_facts(priced)) if json else print_plan(priced)


def scan(plan_file: PlanFile, out: Out, rig: File = None) -> int:
    """Scan without the browser. An unfinished dataset of the same plan is gone on with. Ctrl-C stops the rig.

    Args:
        plan_file: The plan.
        out: The dataset, NAME.wafer.
        rig: RIG.toml of the instrument; the virtual rig without it.
    """
    from wafer_viewer.session.drafting import read_job
    from wafer_viewer.session.scan_command import scan_to

    job = read_job(plan_file)
    with _opened(rig) as device, progress("Scan") as tell:
        ended = scan_to(out, job, device, tell)
    if ended.error is not None:
        raise RigError(ended.error)
    print(f"{out}: {ended.words}")
    return INTERRUPTED if ended.stopped else 0


def import_(
    src: Sources,
    out: Out,
    z_step_um: Um = None,
    pixel_um: Um = None,
    pattern: Text = None,
    overlap_fraction: float = 0.1,
) -> None:
    """Make a dataset of images taken elsewhere: one field, or a grid of fields told apart by a name pattern.

    Args:
        src: A folder of images, a multi-page TIFF, or image files; 2 comes before 10.
        out: The dataset, NAME.wafer.
        z_step_um: Distance between frames; negative when they were taken downward.
        pixel_um: Size of a pixel on the sample.
        pattern: How files are named, such as r{row}_c{col}_k{k}.tif.
        overlap_fraction: Overlap of neighbouring fields.
    """
    from wafer_viewer.store.importers import import_dataset

    _require_sources(src)
    with progress("Import") as tell:
        dataset = import_dataset(src, out, z_step_um, pixel_um, pattern, overlap_fraction, progress=tell)
    print(f"{out}: {len(dataset.fields)} fields of {dataset.scan.plan.sweep.n_frames} frames")


def reconstruct(
    src: Sources,
    out: Out,
    recipe: Recipe = Recipe(),
    z_step_um: Um = None,
    pixel_um: Um = None,
    result: str = "default",
) -> None:
    """Make a surface and write it to a file, whose ending picks the format: .npz .tif .ply .stl .csv.

    Args:
        src: A folder of images, a multi-page TIFF, image files, or one NAME.wafer, of which the mosaic is written.
        out: The file.
        recipe: --recipe RECIPE.toml gives all settings, --recipe.FIELD VALUE single ones.
        z_step_um: Distance between frames, where SRC does not say.
        pixel_um: Size of a pixel on the sample, where SRC does not say.
        result: Name under which a NAME.wafer keeps its surfaces.
    """
    from wafer_viewer.session.offline import surface_of
    from wafer_viewer.store.exporters import export, require_known

    _require_sources(src)
    require_known(out)
    with progress("Reconstruction") as tell:
        surface = surface_of(src, recipe, z_step_um, pixel_um, result, tell)
    export(surface, out)
    print(out)


def stitch(
    dataset: DatasetFolder,
    recipe: Recipe = Recipe(),
    result: str = "default",
    again: bool = False,
) -> None:
    """Make the stitched surface of a dataset; fields that have no heights yet get theirs first.

    Args:
        dataset: The dataset.
        recipe: --recipe RECIPE.toml gives all settings, --recipe.FIELD VALUE single ones.
        result: Name under which the surfaces are kept.
        again: Make the heights of all fields again.
    """
    from wafer_viewer.session.offline import make_surface

    with progress("Stitching") as tell:
        info = make_surface(dataset, recipe, result, again=again, tell=tell)
    print_json({name: value for name, value in msgspec.to_builtins(info).items() if name != "stamp"})


def measure_step(
    src: Source,
    upper: Rectangle,
    lower: Rectangle,
    field: int = 0,
    result: str = "default",
) -> None:
    """The height of one rectangle over another, with its uncertainty, as JSON. Stage um.

    Args:
        src: A NAME.wafer or a surface file, .npz.
        upper: Two opposite corners of the upper rectangle.
        lower: Two opposite corners of the lower rectangle.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
    """
    from wafer_viewer.measure.step import step_height
    from wafer_viewer.session.offline import measured_surface

    surface, calibrated = measured_surface(src, field, result)
    found = step_height(surface, Region.rectangle(*upper), Region.rectangle(*lower), calibration_valid=calibrated)
    print_json(msgspec.to_builtins(found))


def measure_profile(
    src: Source,
    line: Rectangle,
    width_um: float = 0.0,
    field: int = 0,
    result: str = "default",
    points: bool = False,
) -> None:
    """A section along a line, as JSON. Stage um.

    Args:
        src: A NAME.wafer or a surface file, .npz.
        line: The two ends of the line.
        width_um: Width across the line that is averaged over.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
        points: Also print the points of the section.
    """
    from wafer_viewer.measure.profile import profile
    from wafer_viewer.session.offline import measured_surface

    surface, calibrated = measured_surface(src, field, result)
    found, curve = profile(surface, Region.line(*line, width_um=width_um), calibration_valid=calibrated)
    facts: dict[str, Any] = msgspec.to_builtins(found)
    if points:
        facts["points"] = {"distance_um": curve.distance_um.tolist(), "z_um": curve.z_um.tolist()}
    print_json(facts)


def check(dataset: DatasetFolder) -> int:
    """Test every checksum of a dataset and name missing frames; status 1 when there is something to mend.

    Args:
        dataset: The dataset.
    """
    from wafer_viewer.store.dataset import Dataset

    data = Dataset.open(dataset)
    with progress("Check") as tell:
        report = data.check(tell)
    print_check(data, report)
    return 0 if report.ok else 1


def convert(src: Source, out: Annotated[Positional[Path], arg(metavar="FILE")]) -> None:
    """Write a surface in another format, named by the ending: .npz .tif .ply .stl .csv.

    Args:
        src: A surface file, .npz.
        out: The file to write.
    """
    from wafer_viewer.store.exporters import export, require_known
    from wafer_viewer.store.npz import read_npz

    require_known(out)
    export(read_npz(src), out)
    print(out)


def doctor(rig: File = None, data: Path = DATA_FOLDER) -> int:
    """What this machine has and lacks, and the line that mends it; status 1 when something is lacking.

    Args:
        rig: RIG.toml of the instrument; the virtual rig without it.
        data: Folder of the datasets.
    """
    from wafer_viewer.session.doctor import examine

    return print_checks(examine(_config(rig), data.expanduser()))


def _config(rig: Path | None) -> RigConfig:
    """The rig's configuration; the virtual rig without a file."""
    from wafer_viewer.rigs.config import RigConfig, read_config

    return RigConfig() if rig is None else read_config(rig)


@contextmanager
def _opened(rig: Path | None) -> Generator[Rig]:
    """The rig, put at rest and let go at the end."""
    from wafer_viewer.rigs.config import open_rig

    device = open_rig(_config(rig))
    try:
        yield device
    finally:
        device.close()


def _require_sources(src: tuple[Path, ...]) -> None:
    if not src:
        raise DatasetError("There are no images: give a folder of images, a multi-page TIFF or image files.")
