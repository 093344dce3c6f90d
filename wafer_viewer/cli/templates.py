"""Commands of templates: measurements that are repeated on many surfaces."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from wafer_viewer.cli.arguments import DatasetFolder, File, Out, Sources
from wafer_viewer.cli.output import progress
from wafer_viewer.draw.number_format import plural
from wafer_viewer.model.measurement.template import PlacesFrom

TemplateFile = Annotated[Positional[Path], arg(metavar="TEMPLATE.toml")]


def measure_template(
    dataset: DatasetFolder, out: Out, places_from: PlacesFrom = "stage", result: str = "default"
) -> None:
    """Write the kept results of a dataset as a template: their tools, places, settings and levelling.

    Args:
        dataset: The dataset with the results.
        out: The file, TEMPLATE.toml.
        places_from: Zero of the places: the stage, or the lower left corner of each surface.
        result: Name of the reconstruction.
    """
    from wafer_viewer.session.files.template import template_of, write_template

    template = template_of(dataset, result=result, places_from=places_from)
    write_template(template, out)
    print(f"{out}: {plural(len(template.measurements), 'measurement')}")


def measure_apply(
    template: TemplateFile, src: Sources, table: File = None, again: bool = False, result: str = "default"
) -> int:
    """Measure many surfaces by a template: a line for each, a column for each quantity and for its U.

    A surface that fails is told and the next one follows; status 1 at the end. Run again with the same table, the
    command goes on where it ended.

    Args:
        template: What is measured and where, as `measure template` writes it.
        src: Datasets, surface files, or patterns such as 'parts/*.x3p'.
        table: .csv, or .xlsx with the CSV beside it.
        again: Also measure what the table has as done.
        result: Name of the reconstruction of datasets.
    """
    from wafer_viewer.session.files.template import apply_template, read_template

    def told(row: Mapping[str, Any]) -> None:
        end = f"measured in {row['seconds']} s" if row["status"] == "done" else ""
        print(": ".join(filter(None, (str(row["source"]), end, str(row.get("message", ""))))), flush=True)

    with progress("Measuring") as tell:
        report = apply_template(
            read_template(template), src, table, result=result, again=again, progress=tell, told=told
        )
    kept = f", {report.kept} were done before" if report.kept else ""
    print(f"{report.done} measured, {report.failed} failed{kept}" + ("" if table is None else f": {table}"))
    return 1 if report.failed else 0
