"""Report as one self-contained, printable HTML file. The same report gives the same bytes."""

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
    """Return the HTML text; all strings from people or files are escaped."""
    return _template().render(report=report)


def write_report(report: Report, path: Path) -> None:
    """Write the report atomically. Raises DatasetError when the path cannot be written to."""
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
