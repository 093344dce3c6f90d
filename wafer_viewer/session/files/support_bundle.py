"""Support file: what somebody far away needs to find a fault, without secrets and without pictures.

Addresses of the page, keys and passwords are taken out of every text, and names of the account, of its home folder and
of the machine are replaced. Keys and tokens are never read; the names of lots and wafers are in the records of a
dataset, which is only included when it is named.
"""

from __future__ import annotations

import os
import platform
import re
import socket
import zipfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib.metadata import distributions
from pathlib import Path

from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.model.spec import encode
from wafer_viewer.rigs.rig_config import RigConfig
from wafer_viewer.session.core.audit_trail import account
from wafer_viewer.session.core.environment_check import EnvironmentCheck
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.io.atomic_files import atomic_write, os_errors_as_dataset_errors

LONGEST_BYTES = 2_000_000
"""Most of a log or journal that is included, from its end."""
RESULT_FILES = ("recipe.json", "surface.json", "findings.json", "verdict.json", "inspection.json")
_SECRETS = (
    re.compile(r"((?:token|password|passwd|secret|key)[\"']?\s*[=:]\s*[\"']?)[^\s\"'&,;]+", re.IGNORECASE),
    re.compile(r"(-----BEGIN [A-Z ]*PRIVATE KEY-----).*?(?=-----END|\Z)", re.DOTALL),
)
_SHORTEST_NAME = 3
"""Characters of a name from which it is replaced: shorter ones are parts of words."""


@dataclass(frozen=True, slots=True)
class Redaction:
    """Names that are replaced in every text of a support file."""

    home: str
    user: str
    machine: str

    @classmethod
    def of_this_machine(cls) -> Redaction:
        """Return the names of this account and machine."""
        return cls(str(Path.home()), account(), socket.gethostname())

    def text(self, text: str) -> str:
        """Return a text without secrets and without these names."""
        for secret in _SECRETS:
            text = secret.sub(r"\1[removed]", text)
        text = text.replace(self.home, "~") if len(self.home) > 1 else text
        for name, instead in ((self.user, "[user]"), (self.machine, "[machine]")):
            if len(name) >= _SHORTEST_NAME:
                text = re.sub(rf"(?<!\w){re.escape(name)}(?!\w)", instead, text)
        return text


def viewer_log() -> Path:
    """Return the log file of the viewer: ``WAFER_VIEWER_LOG``, else one in the user's state folder."""
    state = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state")
    return Path(os.environ.get("WAFER_VIEWER_LOG") or state / "wafer-viewer" / "viewer.log")


def write_bundle(
    out: Path,
    checks: Iterable[EnvironmentCheck],
    config: RigConfig,
    dataset: Path | None = None,
    names: Redaction | None = None,
) -> tuple[str, ...]:
    """Write a support file and return the names of what it holds.

    Parameters
    ----------
    out : Path
        The file, .zip; an existing one is replaced.
    checks : iterable of EnvironmentCheck
        What the machine has and lacks.
    config : RigConfig
        Configuration of the rig.
    dataset : Path, optional
        A dataset whose records are included; its frames and surfaces are not. Default: none.
    names : Redaction, optional
        Names that are replaced. Default: those of this account and machine.

    Returns
    -------
    tuple of str
        Names of the files in it.

    Raises
    ------
    DatasetError
        When the file cannot be written, or the dataset cannot be opened.
    """
    redaction = names or Redaction.of_this_machine()
    texts = {
        "environment.txt": "\n".join(_words(check) for check in checks),
        "system.txt": "\n".join(_system()),
        "packages.txt": "\n".join(sorted(f"{one.name} {one.version}" for one in distributions())),
        "rig.toml": encode(config),
        **{f"log/{path.name}": _tail(path) for path in (viewer_log(), viewer_log().with_suffix(".log.1"))},
        **({} if dataset is None else dict(_records(Dataset.open(dataset)))),
    }
    held = {name: redaction.text(text) for name, text in texts.items() if text}
    with (
        os_errors_as_dataset_errors(out),
        atomic_write(out) as part,
        zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as archive,
    ):
        for name, text in held.items():
            archive.writestr(name, text)
    return tuple(held)


def _records(data: Dataset) -> Iterator[tuple[str, str]]:
    """Yield name and text of the records of a dataset: no frames, no surfaces."""
    for name in ("scan.json", "journal.jsonl"):
        yield f"dataset/{name}", _tail(data.path / name)
    for result in data.results():
        folder = data.result(result).path
        for name in RESULT_FILES:
            yield f"dataset/results/{result}/{name}", _tail(folder / name)
    yield (
        "dataset/files.txt",
        "\n".join(
            f"{path.stat().st_size:12d} {path.relative_to(data.path)}"
            for path in sorted(data.path.rglob("*"))
            if path.is_file() and not any(part.endswith(".zarr") for part in path.parts)
        ),
    )


def _tail(path: Path) -> str:
    """Return the end of a text file; empty if there is none."""
    if not path.is_file():
        return ""
    try:
        with path.open("rb") as file:
            file.seek(max(0, path.stat().st_size - LONGEST_BYTES))
            return file.read().decode(errors="replace")
    except OSError as fault:
        return f"{path.name} cannot be read: {fault.strerror}."


def _words(check: EnvironmentCheck) -> str:
    return f"{'ok  ' if check.well else 'FIX '} {check.what}: {check.found}" + (
        "" if check.well else f"\n     mend: {check.mend}"
    )


def _system() -> Iterator[str]:
    yield f"{platform.system()} {platform.release()}, {platform.machine()}"
    yield f"Python {platform.python_version()}, {os.cpu_count()} processors"
    try:
        pages = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (ValueError, OSError, AttributeError):  # not on every system
        return
    yield f"{pages / 1e9:.1f} GB of memory"


def require_zip(out: Path) -> Path:
    """Return the name of a support file. Raises WaferViewerError if it is no .zip."""
    if out.suffix.lower() != ".zip":
        raise WaferViewerError(f"{out} is no name of a support file: let it end in .zip.")
    if out.is_dir():
        raise DatasetError(f"{out} is a folder: name a file.")
    return out
