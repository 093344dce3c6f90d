"""Import of images and export of surfaces, as background work on the workers with progress."""

from __future__ import annotations

from concurrent.futures import Future
from pathlib import Path
from typing import Any

from wafer_viewer.model.file_formats import Reading
from wafer_viewer.model.region import Region
from wafer_viewer.model.report import ReportOrder
from wafer_viewer.model.surface.comparison import comparison_of
from wafer_viewer.session.core.background_work import BackgroundWork
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.core.dataset_library import ENDING, Library, free_name
from wafer_viewer.session.files.surface_import import import_surface
from wafer_viewer.session.reporting.report import make_report
from wafer_viewer.session.surface.worker_tasks import export_surface, import_images


class FileWork:
    """Import, export and report work. Use on the session's thread only."""

    def __init__(self, desk: CommandQueue, library: Library, background: BackgroundWork) -> None:
        self._desk, self._library, self._background = desk, library, background

    def import_images(self, srcs: tuple[Path, ...], options: dict[str, Any], name: str | None) -> Future[Path]:
        """Import images into a dataset; the future's result is its path."""
        folder = self._desk.now.data_folder
        wish = Path(name).name.removesuffix(ENDING) if name else free_name(folder, srcs[0].stem if srcs else "import")
        out = folder / f"{wish}{ENDING}"
        return self._background.run(
            f"Import of {out.stem}", import_images, tuple(Path(s).absolute() for s in srcs), out, options
        )

    def import_surface(self, src: Path, says: Reading, name: str | None) -> Future[Path]:
        """Import a surface file into a dataset; the future's result is its path."""
        wish = Path(name).name.removesuffix(ENDING) if name else free_name(self._desk.now.data_folder, src.stem)
        out = self._desk.now.data_folder / f"{wish}{ENDING}"
        return self._background.run(f"Import of {out.stem}", import_surface, src.absolute(), out, says)

    def export_surface(
        self, path: Path, field_number: int | None, every: int | None = None, part: Region | None = None
    ) -> Future[Path]:
        """Write the mosaic, a field's surface or the displayed comparison layer to a file; the result is its path."""
        dataset, result = self._library.dataset, self._library.result_name
        if (asked := comparison_of(field_number or 0)) is not None:
            result = next((c.name for c in self._desk.now.comparisons if c.number == asked[0]), result)
            field_number = -asked[1]
        args = (dataset.path, result, field_number, path.absolute(), every, part)
        return self._background.run(f"Export to {path.name}", export_surface, *args)

    def write_report(self, order: ReportOrder, out: Path) -> Future[Path]:
        """Write the report of the open dataset; the future's result is its path."""
        dataset = self._library.dataset
        args = (dataset.path, self._library.result_name, order, out.absolute())
        return self._background.run(f"Report of {dataset.path.stem}", make_report, *args)
