"""The token that lives with the data folder: one for all starts, the user's own, renewed on demand."""

from __future__ import annotations

import os
import stat
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.session.core.private_file import new_token, page_token

posix = pytest.mark.skipif(sys.platform == "win32", reason="owners and modes of POSIX")


def file_of(folder: Path) -> Path:
    return folder / ".wafer-viewer" / "token"


def test_every_start_on_a_folder_has_the_same_token_until_it_is_renewed(tmp_path: Path) -> None:
    first = page_token(tmp_path)
    assert len(first) >= 32
    assert page_token(tmp_path) == first
    assert page_token(tmp_path / "other") != first
    renewed = page_token(tmp_path, renew=True)
    assert renewed != first
    assert page_token(tmp_path) == renewed
    assert [path.name for path in file_of(tmp_path).parent.iterdir()] == ["token"]


def test_programs_that_start_at_once_agree(tmp_path: Path) -> None:
    with ThreadPoolExecutor(8) as starts:
        assert len(set(starts.map(page_token, [tmp_path] * 16))) == 1


@posix
def test_the_draft_of_a_program_that_starts_just_now_is_no_second_name(tmp_path: Path) -> None:
    token = page_token(tmp_path)
    draft = file_of(tmp_path).with_name("token-draft")
    os.link(file_of(tmp_path), draft)
    with ThreadPoolExecutor(1) as later:
        later.submit(lambda: (time.sleep(0.1), draft.unlink()))
        assert page_token(tmp_path) == token


@posix
def test_its_owner_alone_may_read_it_whatever_the_mask(tmp_path: Path) -> None:
    before = os.umask(0)
    try:
        page_token(tmp_path)
    finally:
        os.umask(before)
    assert stat.S_IMODE(file_of(tmp_path).stat().st_mode) == 0o600


@posix
@pytest.mark.parametrize("mode", [0o640, 0o604, 0o622])
def test_one_that_others_could_read_or_write_is_refused(tmp_path: Path, mode: int) -> None:
    page_token(tmp_path)
    file_of(tmp_path).chmod(mode)
    with pytest.raises(DatasetError, match=r"can be read or written by others.*--new-token"):
        page_token(tmp_path)
    page_token(tmp_path, renew=True)
    assert stat.S_IMODE(file_of(tmp_path).stat().st_mode) == 0o600


@posix
def test_a_link_is_never_followed_neither_to_read_nor_to_renew(tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.write_text(new_token())
    elsewhere.chmod(0o600)
    placed = elsewhere.read_text()
    file_of(tmp_path).parent.mkdir()
    file_of(tmp_path).symlink_to(elsewhere)
    with pytest.raises(DatasetError, match="is a symbolic link"):
        page_token(tmp_path)
    assert page_token(tmp_path, renew=True) != placed
    assert not file_of(tmp_path).is_symlink()
    assert elsewhere.read_text() == placed


@pytest.mark.slow
@posix
def test_a_file_with_a_second_name_or_of_another_user_is_refused(tmp_path: Path, monkeypatch) -> None:
    page_token(tmp_path)
    os.link(file_of(tmp_path), tmp_path / "second")
    with pytest.raises(DatasetError, match="has a second name"):
        page_token(tmp_path)
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    with pytest.raises(DatasetError, match="belongs to another user"):
        page_token(tmp_path)


@pytest.mark.parametrize("text", ["", "short", "x" * 300, "with spaces " * 4, "\x00" * 40])
def test_what_is_no_token_is_refused(tmp_path: Path, text: str) -> None:
    page_token(tmp_path)
    file_of(tmp_path).write_text(text)
    with pytest.raises(DatasetError, match="holds no token"):
        page_token(tmp_path)


@posix
def test_a_pipe_in_its_place_does_not_hold_up_the_start(tmp_path: Path) -> None:
    file_of(tmp_path).parent.mkdir()
    os.mkfifo(file_of(tmp_path), 0o600)
    with pytest.raises(DatasetError, match="is not a file"):
        page_token(tmp_path)


def test_a_folder_that_cannot_be_written_to_has_a_token_for_one_run(tmp_path: Path, monkeypatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "link", refuse)
    assert page_token(tmp_path) != page_token(tmp_path)
    assert not list(file_of(tmp_path).parent.iterdir())
