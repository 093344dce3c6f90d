"""The folder of the files that browsers sent: names from outside, number, size and lifetime."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
import viser
import viser._messages as viser_messages

from wafer_viewer.gui.page import uploads
from wafer_viewer.gui.page.uploads import KEPT_S, MOST_KEPT, UploadFolder, refuse_upload, remove_orphans, save_upload
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.session.state.snapshot import Browser, ControlState, Snapshot


@pytest.mark.parametrize(
    ("name", "saved"),
    [
        ("scan.csv", "scan.csv"),
        ("../../etc/passwd", "passwd"),
        ("/root/.ssh/authorized_keys", "authorized_keys"),
        ("..\\..\\boot.ini", "boot.ini"),
        ("..", "upload"),
        ("dir/..", "upload"),
        (".", "upload"),
        ("", "upload"),
        ("/", "upload"),
        ("a\0b.csv", "ab.csv"),
        ("x" * 300, "upload"),
        ("\u00b5" * 150, "upload"),
        ("<script>.csv", "<script>.csv"),
    ],
)
def test_of_a_name_from_outside_only_the_last_part_is_used(tmp_path: Path, name: str, saved: str) -> None:
    target = UploadFolder(tmp_path).save(name, b"abc", "upload")
    assert target.name == saved
    assert target.read_bytes() == b"abc"
    assert target.parent.parent == tmp_path
    assert not target.is_symlink()


def test_two_files_of_one_name_do_not_meet(tmp_path: Path) -> None:
    folder = UploadFolder(tmp_path)
    first, second = (folder.save("scan.csv", content, "upload") for content in (b"1", b"2"))
    assert (first.read_bytes(), second.read_bytes()) == (b"1", b"2")


def test_of_a_file_that_the_disk_has_no_space_for_nothing_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def write(path: Path, content: bytes) -> int:
        with path.open("wb") as file:
            file.write(content[: len(content) // 2])
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", write)
    with pytest.raises(
        DatasetError, match=r"scan\.csv was sent and cannot be kept in .*: the disk is full\. Free some"
    ):
        UploadFolder(tmp_path).save("scan.csv", b"123456", "upload")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(sys.platform == "win32", reason="modes of POSIX")
def test_others_cannot_read_what_was_sent() -> None:
    target = save_upload(viser.UploadedFile("scan.csv", b"abc"))
    above = target.parent.parent
    assert [folder.stat().st_mode & 0o077 for folder in (above, target.parent)] == [0, 0]


def test_the_oldest_give_way_to_new_ones(tmp_path: Path) -> None:
    folder = UploadFolder(tmp_path)
    saved = [folder.save(f"{k}.csv", b"x", "upload") for k in range(MOST_KEPT + 3)]
    assert [path.exists() for path in saved] == [False] * 3 + [True] * MOST_KEPT
    assert len(list(tmp_path.iterdir())) == MOST_KEPT


def test_together_they_take_no_more_room_than_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(uploads, "MOST_KEPT_BYTES", 10)
    folder = UploadFolder(tmp_path)
    saved = [folder.save(f"{k}.csv", b"x" * 4, "upload") for k in range(3)]
    assert [path.exists() for path in saved] == [False, True, True]


def test_a_file_is_removed_after_a_shift_without_a_further_one(tmp_path: Path, monkeypatch) -> None:
    now, timers = [0.0], []
    monkeypatch.setattr(uploads, "_later", timers.append)
    folder = UploadFolder(tmp_path, lambda: now[0])
    old = folder.save("old.csv", b"x", "upload")
    now[0] = KEPT_S - 1
    young = folder.save("young.csv", b"x", "upload")
    assert old.exists()
    now[0] = KEPT_S
    timers[0]()
    assert (old.exists(), young.exists()) == (False, True)
    assert not old.parent.exists()


@pytest.mark.slow
def test_what_was_sent_is_gone_when_the_program_ends(tmp_path: Path) -> None:
    code = (
        "import viser; from wafer_viewer.gui.page.uploads import save_upload; "
        "print(save_upload(viser.UploadedFile('a.csv', b'x')))"
    )
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert Path(done.stdout.strip()).is_relative_to(tmp_path)
    assert not list(tmp_path.glob("wafer-viewer-sent-*"))


def test_folders_of_killed_programs_are_removed_and_no_others(tmp_path: Path) -> None:
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    orphan, running = (tmp_path / f"wafer-viewer-sent-{pid}-x" for pid in (ended.pid, os.getpid()))
    elsewhere, odd = tmp_path / "elsewhere", tmp_path / "wafer-viewer-sent-y-z"
    for folder in (orphan, running, elsewhere, odd):
        folder.mkdir()
        (folder / "file").write_text("x")
    link = tmp_path / f"wafer-viewer-sent-{ended.pid}-link"
    link.symlink_to(elsewhere)
    remove_orphans(tmp_path)
    assert not orphan.exists()
    assert all((folder / "file").exists() for folder in (running, elsewhere, odd, link))


class Page(SimpleNamespace):
    """The parts of a page that a refusal needs."""

    def __init__(self, key: str, holder: str | None) -> None:
        control = ControlState(browsers=(Browser("a", "Anna"), Browser("b", "Ben")), holder=holder)
        self.told: list[str] = []
        self.queued: list[viser_messages.FileTransferPartAck] = []
        super().__init__(
            browser=SimpleNamespace(key=key),
            session=SimpleNamespace(snapshot=Snapshot(control=control)),
            gui=SimpleNamespace(_websock_interface=SimpleNamespace(queue_message=self.queued.append)),
            say=lambda title, text, tone: self.told.append(f"{title}: {text}"),
        )


@pytest.mark.parametrize(("key", "holder"), [("b", "a"), ("b", None), ("", "a"), ("", "")])
def test_who_does_not_hold_the_controls_is_told_and_the_progress_on_the_page_ends(key: str, holder: str | None) -> None:
    page = Page(key, holder)
    start = viser_messages.FileTransferStartUpload("button", "transfer", "scan.csv", "text/csv", 3, 1500)
    assert refuse_upload(page, start)  # pyright: ignore[reportArgumentType]
    assert page.told[0].startswith("The file was not sent: ")
    assert [(ack.transferred_bytes, ack.total_bytes) for ack in page.queued] == [(1500, 1500)]


def test_the_holder_of_the_controls_sends() -> None:
    page = Page("a", "a")
    start = viser_messages.FileTransferStartUpload("button", "transfer", "scan.csv", "text/csv", 3, 1500)
    assert not refuse_upload(page, start)  # pyright: ignore[reportArgumentType]
    assert (page.told, page.queued) == ([], [])
