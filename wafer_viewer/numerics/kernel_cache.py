"""Folders of compiled kernels. Imports neither numba nor anything else that is heavy.

numba recognises a change of a function by the path and the contents of its file; but kernels inline each other across
files, and a second checkout or an installation has other paths. Here the kernels of a module have a folder by the
sources of that module and of all that it imports from the rooms with kernels, and nothing else is compared. An edit
thus compiles anew only what depends on it, and every copy of the same sources finds the same kernels. A folder belongs
to one version of numba, which itself tells processors apart.
"""

from __future__ import annotations

import functools
import os
import re
import shutil
import sys
import zlib
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryFile

PACKAGE = Path(__file__).parent.parent
KERNEL_ROOMS = ("numerics", "reconstruct", "rigs/virtual")
ALL_KERNELS_BYTES = 100_000_000
"""Free space from which kernels are written: numba raises the error of a disk that fills up meanwhile."""
_IMPORT = re.compile(r"^\s*(?:from|import) +wafer_viewer\.([\w.]+)(?: +import +(\([^)]*\)|.*))?", re.MULTILINE)


def cache_folder() -> Path:
    """Return the folder of compiled kernels, under ``WAFER_VIEWER_CACHE`` or ``~/.cache/wafer-viewer``."""
    home = os.environ.get("WAFER_VIEWER_CACHE")
    base = Path(home) if home else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "wafer-viewer"
    return base / "kernels" / f"numba-{_version_of_numba()}"


@functools.cache
def _version_of_numba() -> str:
    return version("numba")


@functools.cache
def _state_of(file: Path) -> str:
    return fingerprint(sources_of(file))


def module_folder(module: str, file: Path) -> Path:
    """Return the folder of the kernels of a module, which is in a file."""
    return cache_folder() / f"{module}-{_state_of(file)}"


@functools.cache
def is_writable(folder: Path) -> bool:
    """Return whether all kernels can be written to a folder, which is made if it is missing."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        TemporaryFile(dir=folder).close()
        return shutil.disk_usage(folder).free >= ALL_KERNELS_BYTES
    except OSError:
        return False


def kernel_state() -> str:
    """Return a name that changes with any source of a kernel, with Python and with the processor."""
    import llvmlite.binding as llvm

    try:
        features = llvm.get_host_cpu_features().flatten()
    except RuntimeError:  # the processor does not tell
        features = ""
    machine = zlib.crc32(f"{sys.implementation.cache_tag} {llvm.get_host_cpu_name()} {features}".encode())
    files = (file for room in KERNEL_ROOMS for file in sorted((PACKAGE / room).rglob("*.py")))
    return f"{fingerprint(files)}-{machine:08x}"


def fingerprint(files: Iterable[Path]) -> str:
    """Return eight hex digits that change with any of the files."""
    return f"{functools.reduce(lambda crc, file: zlib.crc32(file.read_bytes(), crc), files, 0):08x}"


def sources_of(file: Path) -> tuple[Path, ...]:
    """Return a file and all that it imports from the rooms with kernels, directly or not."""
    found, wanted = {file}, [file]
    while wanted:
        new = {
            imported for name in _names_imported_by(wanted.pop()) if (imported := _file_of(name)) is not None
        } - found
        found |= new
        wanted += new
    return tuple(sorted(found))


@functools.cache
def _names_imported_by(file: Path) -> tuple[str, ...]:
    """Return the modules, and the names within them, that a file imports from the rooms with kernels, dotted."""
    rooms = tuple(room.replace("/", ".") for room in KERNEL_ROOMS)
    found = [(module, names) for module, names in _IMPORT.findall(file.read_text()) if module.startswith(rooms)]
    return tuple(
        name
        for module, names in found
        for name in (module, *(f"{module}.{part}" for part in re.findall(r"\w+", names)))
    )


@functools.cache
def _file_of(module: str) -> Path | None:
    path = PACKAGE.joinpath(*module.split("."))
    return next((file for file in (path.with_suffix(".py"), path / "__init__.py") if file.is_file()), None)
