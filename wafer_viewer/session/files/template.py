"""Measurements repeated on many surfaces by a template, with one table of their numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from wafer_viewer.measure.base.levelled_surface import levelled
from wafer_viewer.measure.registry import measured
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.measurement.feature import Die, on_die
from wafer_viewer.model.measurement.template import MeasurementTemplate, PlacesFrom, TemplateItem
from wafer_viewer.model.measurement.tools import TOOL_OF_RESULT, ToolOptions
from wafer_viewer.model.progress import Progress, ShouldStop, never, silent
from wafer_viewer.model.spec import decode, encode, replace
from wafer_viewer.model.surface.height_map import Mosaic
from wafer_viewer.session.files.batch import BatchReport, columns_of, run_batch
from wafer_viewer.session.surface.headless import measured_surface
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.io.atomic_files import write_text
from wafer_viewer.store.io.guarded_reading import read_content


def template_of(
    dataset: str | Path, *, result: str = "default", places_from: PlacesFrom = "stage"
) -> MeasurementTemplate:
    """Return the kept results of a dataset as a template: their tools, places, settings and levelling.

    Parameters
    ----------
    dataset : str or Path
        Dataset whose results were kept.
    result : str, optional
        Name of the reconstruction. Default 'default'.
    places_from : {'stage', 'corner'}, optional
        Zero of the places of the template. Default 'stage': that of the stage. 'corner': the lower left corner of each
        surface.

    Returns
    -------
    MeasurementTemplate
        The measurements of the results on the stitched surface, by name. Gauge checks and defects are none.

    Raises
    ------
    DatasetError
        If the folder is no dataset.
    MeasureError
        If no result of a measuring tool was kept, or two have the same name.
    """
    stored = Dataset.open(Path(dataset)).result(result)
    corner = _corner(stored.mosaic()) if places_from == "corner" else (0.0, 0.0)
    items = tuple(_items(stored.findings().items, corner))
    if not items:
        raise MeasureError(f"{Path(dataset).name} has no kept results of measuring tools on its stitched surface.")
    return MeasurementTemplate(places_from=places_from, measurements=items)


def _items(findings: Sequence[AnyResult], corner: tuple[float, float]) -> Iterator[TemplateItem]:
    for finding in findings:
        tool = TOOL_OF_RESULT.get(type(finding))
        if tool is None or finding.show:
            continue
        options = getattr(finding, "options", None)
        own = replace(ToolOptions(), **{tool.name: options}) if options is not None and tool.options else None
        places = tuple(on_die(place, Die(name="", x_um=-corner[0], y_um=-corner[1])) for place in finding.inputs)
        yield TemplateItem(
            name=finding.name or f"{tool.short} {finding.number}",
            tool=tool.name,
            places=places,
            options=own,
            levelling=finding.levelling,
        )


def read_template(path: str | Path) -> MeasurementTemplate:
    """Read a template from a TOML file.

    Parameters
    ----------
    path : str or Path
        File as `write_template` writes it.

    Returns
    -------
    MeasurementTemplate
        Measurements with tool, places, settings and levelling.

    Raises
    ------
    DatasetError
        If the file cannot be read.
    MeasureError
        If a value is wrong; the sentence names it.
    """
    return decode(read_content(Path(path)), MeasurementTemplate, Path(path).name)


def write_template(template: MeasurementTemplate, path: str | Path) -> None:
    """Write a template as TOML.

    Parameters
    ----------
    template : MeasurementTemplate
        What is measured, and where.
    path : str or Path
        File, which is replaced if it exists.

    Raises
    ------
    DatasetError
        If the file cannot be written.
    """
    write_text(Path(path), encode(template))


def apply_template(
    template: MeasurementTemplate,
    sources: Sequence[str | Path],
    table: str | Path | None = None,
    *,
    result: str = "default",
    again: bool = False,
    progress: Progress = silent,
    should_stop: ShouldStop = never,
    told: Callable[[Mapping[str, Any]], None] = lambda row: None,
) -> BatchReport:
    """Measure many surfaces by a template, and write one table with a line for each.

    Parameters
    ----------
    template : MeasurementTemplate
        What is measured, and where.
    sources : sequence of str or Path
        Datasets and surface files; patterns such as ``parts/*.x3p`` are expanded.
    table : str or Path, optional
        CSV file, or Excel file (.xlsx) with the CSV beside it. Default: no table is written.
    result : str, optional
        Name of the reconstruction of datasets. Default 'default'.
    again : bool, default False
        Also measure what the table has as done.
    progress : callable, optional
        Receives the completed fraction, 0 to 1.
    should_stop : callable, optional
        Returns True if the work should stop; asked between sources.
    told : callable, optional
        Receives the line of every source when it is done.

    Returns
    -------
    BatchReport
        How many were measured, failed and kept, and all lines: a column for each quantity, beside it its U (95.45 %).
        A measurement that has no result leaves its columns empty, and the message says why.

    Raises
    ------
    DatasetError
        If there is no source, or the table cannot be written.
    """
    work = partial(measured_by, template, result=result)
    name = f"template {encode(template, 'json')}"
    return run_batch(
        sources, work, table, name=name, again=again, progress=progress, should_stop=should_stop, told=told
    )


def measured_by(template: MeasurementTemplate, source: Path, result: str = "default") -> dict[str, Any]:
    """Return the numbers of all measurements on one surface by column. Raises MeasureError where none has a result."""
    surface, calibrated = measured_surface(source, 0, result)
    corner = _corner(surface) if template.places_from == "corner" else (0.0, 0.0)
    columns: dict[str, Any] = {"simulated": surface.provenance.simulated}
    faults: list[str] = []
    for item in template.measurements:
        try:
            found = _measured(item, surface, calibrated, corner)
        except MeasureError as fault:
            faults.append(f"{item.name}: {fault}")
            continue
        columns |= {_column(item.name, key): value for key, value in columns_of(found.quantities).items()}
    if len(faults) == len(template.measurements):
        raise MeasureError(" ".join(faults))
    return columns | ({"message": " ".join(faults)} if faults else {})


def _column(name: str, key: str) -> str:
    return f"U of {name} {key.removeprefix('U of ')}" if key.startswith("U of ") else f"{name} {key}"


def _measured(item: TemplateItem, surface: Mosaic, calibrated: bool, corner: tuple[float, float]) -> AnyResult:
    places = tuple(on_die(place, Die(name="", x_um=corner[0], y_um=corner[1])) for place in item.places)
    return measured(levelled(surface, item.levelling), item.tool, places, calibrated, item.options)


def _corner(surface: Mosaic) -> tuple[float, float]:
    """Return the centre of the lower left pixel of a surface."""
    return surface.x0_um, surface.y0_um - (surface.shape[0] - 1) * surface.pixel_um
