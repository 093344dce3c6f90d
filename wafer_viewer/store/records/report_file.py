"""A report as one self-contained HTML file that prints well. The same report makes the same bytes."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from wafer_viewer.model.report import Report
from wafer_viewer.store.io.atomic_files import write_text

if TYPE_CHECKING:
    from jinja2 import Template

TEMPLATE = "report.html.j2"


def report_html(report: Report) -> str:
    """The text of the file; everything in it that comes from people or files is escaped."""
    return _template().render(report=report)


def write_report(report: Report, path: Path) -> None:
    """Write it, whole or not at all. Raises DatasetError when the place cannot be written to."""
    write_text(path, report_html(report))


@cache
def _template() -> Template:
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(TEMPLATE)
