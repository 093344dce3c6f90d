"""Files that browsers send: who may send them, and the folder where they are for a while."""

from __future__ import annotations

import atexit
import errno
import os
import shutil
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import viser
import viser._messages as viser_messages

from wafer_viewer.gui.incoming import MOST_UPLOAD_BYTES, UploadStart
from wafer_viewer.gui.page.page import Page
from wafer_viewer.model.errors import DatasetError

MOST_KEPT, MOST_KEPT_BYTES = 1000, 2 * MOST_UPLOAD_BYTES
KEPT_S = 8 * 3600.0
"""Files kept at once, their size, and the time for which each is kept: a shift."""
_PREFIX = "wafer-viewer-sent-"
_LONGEST_NAME_BYTES = 200


def refuse_upload(page: Page, upload: UploadStart) -> bool:
    """Return whether a browser may not send a file, for it does not hold the controls; its page is told why."""
    why = page.session.snapshot.control.why_not(page.browser.key)
    if why is None:
        return False
    # The page shows a file as on its way until all of it has arrived.
    sent = viser_messages.FileTransferPartAck(
        upload.source_component_uuid, upload.transfer_uuid, upload.size_bytes, upload.size_bytes
    )
    page.gui._websock_interface.queue_message(sent)
    page.say("The file was not sent", f"{why} Only the browser that holds them sends files.", "attention")
    return True


def save_upload(file: viser.UploadedFile, otherwise: str = "upload") -> Path:
    """Save an upload in a new temporary folder; of the sender's path only the file name is used.

    otherwise: file name if the sender gave none that can be used.
    """
    return _uploads().save(file.name, file.content, otherwise)


class UploadFolder:
    """Folder of the files sent to this process; the oldest give way to new ones, and none stays for long."""

    def __init__(self, folder: Path, clock: Callable[[], float] = time.monotonic) -> None:
        self._folder, self._clock = folder, clock
        self._kept: deque[tuple[float, Path, int]] = deque()
        self._lock = threading.Lock()

    def save(self, name: str, content: bytes, otherwise: str) -> Path:
        """Save a file, and remove those that there is no more room or time for.

        Raises DatasetError when it cannot be written.
        """
        target = self._written(_safe_name(name, otherwise), content)
        with self._lock:
            self._kept.append((self._clock(), target.parent, len(content)))
        self.sweep()
        _later(self.sweep)
        return target

    def _written(self, name: str, content: bytes) -> Path:
        """Write a file into a folder of its own, and leave nothing if that fails."""
        folder = None
        try:
            folder = Path(tempfile.mkdtemp(dir=self._folder))
            (folder / name).write_bytes(content)
        except OSError as fault:
            if folder is not None:
                shutil.rmtree(folder, ignore_errors=True)
            why = "the disk is full" if fault.errno in (errno.ENOSPC, errno.EDQUOT) else str(fault.strerror).lower()
            raise DatasetError(
                f"{name} was sent and cannot be kept in {self._folder}: {why}. Free some space there, or open the file "
                "by its path."
            ) from fault
        return folder / name

    def sweep(self) -> None:
        """Remove what is too old, and the oldest files beyond the number and the size that are kept."""
        with self._lock:
            while self._kept and (
                self._clock() - self._kept[0][0] >= KEPT_S
                or len(self._kept) > MOST_KEPT
                or sum(n_bytes for _, _, n_bytes in self._kept) > MOST_KEPT_BYTES
            ):
                _, folder, _ = self._kept.popleft()
                shutil.rmtree(folder, ignore_errors=True)


@cache
def _uploads() -> UploadFolder:
    """Return the folder of this process, which is removed when it ends."""
    above = Path(tempfile.gettempdir())
    remove_orphans(above)
    folder = Path(tempfile.mkdtemp(prefix=f"{_PREFIX}{os.getpid()}-", dir=above))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return UploadFolder(folder)


def remove_orphans(above: Path) -> None:
    """Remove this user's folders of processes that were killed."""
    for folder in above.glob(f"{_PREFIX}*-*"):
        number = folder.name.removeprefix(_PREFIX).split("-")[0]
        if number.isdecimal() and not _is_running(int(number)) and _is_own_folder(folder):
            shutil.rmtree(folder, ignore_errors=True)


def _is_running(pid: int) -> bool:
    import psutil

    return psutil.pid_exists(pid)


def _is_own_folder(path: Path) -> bool:
    """Return whether a path is a folder of this user, and no link to one."""
    if path.is_symlink() or not path.is_dir():
        return False
    return not hasattr(os, "geteuid") or path.stat().st_uid == os.geteuid()


def _safe_name(name: str, otherwise: str) -> str:
    """Return the last part of a path of any system, if it can be the name of a file here."""
    last = name.replace("\\", "/").rpartition("/")[2].replace("\0", "")
    usable = last not in ("", ".", "..") and len(os.fsencode(last)) <= _LONGEST_NAME_BYTES
    return last if usable else otherwise


def _later(do: Callable[[], Any]) -> None:
    timer = threading.Timer(KEPT_S, do)
    timer.daemon = True
    timer.start()
