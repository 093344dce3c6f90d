"""Reports as PDF, printed by the Chromium, Chrome or Edge of this machine; the same report makes the same bytes."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.io.atomic_files import atomic_write

BROWSERS = (
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "chrome",
    "msedge",
    "microsoft-edge",
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
)
_FLAGS = ("--headless", "--disable-gpu", "--no-first-run", "--disable-extensions", "--no-pdf-header-footer")
_LONGEST_S = 120
_DATE = re.compile(rb"(/(?:Creation|Mod)Date \(D:)\d{14}")
_EPOCH = b"20000101000000"
"""Date in the file: when it was printed is not part of a report."""


def print_pdf(html: str, path: Path) -> None:
    """Write a page as PDF. Raises DatasetError where no browser is found, it fails, or the path cannot be written."""
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    instead = path.with_suffix(".html").name
    if browser is None:
        raise DatasetError(
            f"{path.name}: a PDF is printed by Chromium, Chrome or Edge, and none is found: install one, or write "
            f"{instead} and print that."
        )
    with tempfile.TemporaryDirectory(prefix="wafer-viewer-report-") as folder:
        page, printed = Path(folder) / "report.html", Path(folder) / "report.pdf"
        page.write_text(html, encoding="utf-8")
        sandbox = ["--no-sandbox"] if sys.platform == "linux" else []  # the page is our own and runs no script
        words = [browser, *_FLAGS, *sandbox, f"--user-data-dir={folder}/profile", f"--print-to-pdf={printed}"]
        try:
            subprocess.run([*words, page.as_uri()], check=True, capture_output=True, timeout=_LONGEST_S)
            data = printed.read_bytes()
        except (OSError, subprocess.SubprocessError) as fault:
            raise DatasetError(
                f"{path.name} was not printed by {Path(browser).name}: write {instead} and print that."
            ) from fault
    with atomic_write(path) as temporary:
        temporary.write_bytes(_DATE.sub(rb"\g<1>" + _EPOCH, data))
