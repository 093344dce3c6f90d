"""Site of the documentation: its folder, its files and its build."""

from __future__ import annotations

import functools
import importlib.util
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

from wafer_viewer.model.errors import WaferViewerError

PACKAGE = Path(__file__).parents[2]
SHIPPED = PACKAGE / "site"
"""Site that comes with an installed package."""
SOURCES = PACKAGE.parent / "assets" / "docs"
BUILT = SOURCES / "_build" / "html"
"""Site that is built in a checkout."""
FIRST_PAGE = "index.html"
TOOLS = ("sphinx", "pydata_sphinx_theme", "myst_parser", "numpydoc", "sphinx_gallery", "sphinx_copybutton")
EXTRA = "pip install 'wafer-viewer[docs]'"


def site_folder() -> Path | None:
    """Return the folder of the site, None if it is neither shipped nor built."""
    return next((folder for folder in (BUILT, SHIPPED) if (folder / FIRST_PAGE).is_file()), None)


def documentation_files() -> Mapping[str, Path]:
    """Return the files of the site by their paths in its addresses, none if there is no site."""
    folder = site_folder()
    return {} if folder is None else _files_of(folder)


@functools.cache
def _files_of(folder: Path) -> Mapping[str, Path]:
    return {path.relative_to(folder).as_posix(): path for path in folder.rglob("*") if path.is_file()}


def first_page() -> Path:
    """Return the first page of the site. Raises WaferViewerError with the way to build it if there is none."""
    folder = site_folder()
    if folder is None:
        where = "" if SOURCES.is_dir() else ", in a checkout of the sources"
        raise WaferViewerError(f"The documentation is not built: {EXTRA}, then wafer-viewer docs --build{where}.")
    return folder / FIRST_PAGE


def build_site() -> None:
    """Build the site of a checkout; a warning is an error. Raises WaferViewerError if it cannot be built."""
    if not SOURCES.is_dir():
        raise WaferViewerError("There are no sources of the documentation here: build it in a checkout.")
    missing = [name for name in TOOLS if importlib.util.find_spec(name) is None]
    if missing:
        raise WaferViewerError(f"{', '.join(missing)} is needed to build the documentation: {EXTRA}.")
    words = ("-b", "html", "--fail-on-warning", "--keep-going", "--quiet", "-j", "2", "-d", BUILT.parent / "doctrees")
    done = subprocess.run([sys.executable, "-m", "sphinx", *words, SOURCES, BUILT], check=False)
    _files_of.cache_clear()
    if done.returncode:
        raise WaferViewerError("The documentation was not built: the lines above say why.")
