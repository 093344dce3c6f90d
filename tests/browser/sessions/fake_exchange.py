"""Surface files of a session that stands still: by their endings, and no file is read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tests.browser.recording import Recording
from wafer_viewer.session.files.file_jobs import FileJobs


class FakeExchange(Recording):
    """Says what is a surface file by its ending; what comes in is remembered as asked."""

    def __init__(self, session: Any) -> None:
        super().__init__(FileJobs, session._done, "exchange.")

    def is_surface(self, path: Path) -> bool:
        return path.suffix in (".x3p", ".gsf")
