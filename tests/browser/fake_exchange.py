"""Surface files of a session that stands still: by their endings, and no file is read."""

from __future__ import annotations

from concurrent.futures import Future
from pathlib import Path
from typing import Any


class FakeExchange:
    """Says what is a surface file by its ending; what comes in is remembered as asked."""

    def __init__(self, session: Any) -> None:
        self._session = session

    def is_surface(self, path: Path) -> bool:
        return path.suffix in (".x3p", ".gsf")

    def import_surface(self, path: Path, says: Any, name: str | None) -> Future[Any]:
        return self._session.import_surface(path, says, name)
