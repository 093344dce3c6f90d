"""The folders that a file dialog may show, listed by a session: what is offered, in which order, and what is not."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import PIL.Image
import pytest
import tifffile

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.session.files.file_browser import FILE_KINDS, PAGE, Browsing, FileKind, Listing, saved_as

WAIT_S = 30.0
ALL = FileKind(title="All files", endings=("",))


@pytest.fixture
def browsing(tmp_path: Path) -> Iterator[Browsing]:
    (tmp_path / "data").mkdir()
    opened = Browsing(tmp_path / "data", home=None)
    yield opened
    opened.close()


@pytest.fixture
def data(tmp_path: Path, browsing: Browsing) -> Path:
    return tmp_path / "data"


def listed(browsing: Browsing, folder: Path, kind: FileKind = ALL, **how: object) -> Listing:
    return browsing.list_folder(folder, kind, **how).result(WAIT_S)


def names(listing: Listing) -> list[str]:
    return [entry.path.name for entry in listing.entries]


def aged(path: Path, mtime_s: float) -> None:
    os.utime(path, (mtime_s, mtime_s))


def test_folders_come_first_then_the_newest_file(browsing: Browsing, data: Path):
    (data / "b").mkdir()
    for k, name in enumerate(("old.toml", "newer.toml", "newest.toml")):
        (data / name).write_text("x" * (10 + k))
        aged(data / name, 1000 + k)
    found = listed(browsing, data)
    assert names(found) == ["b", "newest.toml", "newer.toml", "old.toml"]
    assert found.parent is None
    assert found.free_bytes > 0
    assert found.entries[1].size_bytes == 12
    assert names(listed(browsing, data, order="name")) == ["b", "newer.toml", "newest.toml", "old.toml"]
    assert names(listed(browsing, data, order="size")) == ["b", "newest.toml", "newer.toml", "old.toml"]


def test_only_what_is_requested_is_listed_and_the_rest_is_counted(browsing: Browsing, data: Path):
    for name in ("a.klarf", "b.toml", "c.txt"):
        (data / name).write_text("x")
    found = listed(browsing, data, FILE_KINDS["plan"])
    assert (names(found), found.n_hidden) == (["b.toml"], 2)


def test_a_folder_is_listed_by_pages_and_by_the_beginning_of_a_name(browsing: Browsing, data: Path):
    for k in range(PAGE + 30):
        (data / f"f{k:04d}.toml").touch()
    first = listed(browsing, data, order="name")
    assert (len(first.entries), first.n_matching) == (PAGE, PAGE + 30)
    assert len(listed(browsing, data, order="name", limit=2 * PAGE).entries) == PAGE + 30
    begun = listed(browsing, data, prefix="F022", order="name")
    assert names(begun) == [f"f022{k}.toml" for k in range(10)]
    assert begun.completion == str(data / "f022")
    assert listed(browsing, data, prefix="f0229").completion == str(data / "f0229.toml")


def test_nothing_outside_of_the_roots_is_listed_or_taken(browsing: Browsing, data: Path, tmp_path: Path):
    outside = tmp_path / "secret"
    outside.mkdir()
    (outside / "key.toml").write_text("x")
    (data / "way-out").symlink_to(outside)
    (data / "key-link.toml").symlink_to(outside / "key.toml")
    (data / "own.toml").write_text("x")
    (data / "own-link.toml").symlink_to(data / "own.toml")
    assert sorted(names(listed(browsing, data))) == ["own-link.toml", "own.toml"]
    for typed in (outside, data / "way-out", data / ".." / "secret", Path("/etc")):
        with pytest.raises(DatasetError, match="--browse"):
            listed(browsing, typed)
    for typed in (outside / "key.toml", data / "key-link.toml", data / ".." / "secret" / "key.toml"):
        with pytest.raises(DatasetError, match="--browse"):
            browsing.existing(str(typed), data)
    assert browsing.existing("own.toml", data) == data / "own.toml"
    assert browsing.look(outside / "key.toml").result(WAIT_S) == b""


def test_the_secrets_of_the_data_folder_are_neither_listed_nor_taken_nor_written_over(browsing: Browsing, data: Path):
    secrets = data / ".wafer-viewer"
    secrets.mkdir()
    for name in ("token", "password", "certificate.pem", "plan.toml"):
        (secrets / name).write_text("x")
    (data / "way-in").symlink_to(secrets)
    assert names(listed(browsing, data, prefix=".")) == []
    for typed in (secrets, data / "way-in"):
        with pytest.raises(DatasetError, match="lies outside"):
            listed(browsing, typed)
    for typed in (".wafer-viewer/plan.toml", "way-in/certificate.pem", "way-in/../.wafer-viewer/token"):
        with pytest.raises(DatasetError, match="lies outside"):
            browsing.existing(typed, data)
        with pytest.raises(DatasetError, match="lies outside"):
            saved_as(browsing, typed, data, ".csv")
    assert browsing.look(secrets / "plan.toml").result(WAIT_S) == b""


def test_a_folder_given_by_the_command_line_is_a_root_too(tmp_path: Path):
    for name in ("data", "lab"):
        (tmp_path / name).mkdir()
    (tmp_path / "lab" / "plan.toml").write_text("x")
    browsing = Browsing(tmp_path / "data", (tmp_path / "lab",), home=None)
    try:
        assert [root.path for root in browsing.roots] == [tmp_path / "data", tmp_path / "lab"]
        assert names(listed(browsing, tmp_path / "lab")) == ["plan.toml"]
    finally:
        browsing.close()
    with pytest.raises(DatasetError, match="not a folder"):
        Browsing(tmp_path / "data", (tmp_path / "nowhere",), home=None)


def test_an_unreadable_file_is_reported(browsing: Browsing, data: Path, monkeypatch: pytest.MonkeyPatch):
    for name in ("mine.toml", "theirs.toml"):
        (data / name).write_text("x")
    monkeypatch.setattr(os, "access", lambda path, mode: "theirs" not in str(path))
    by_name = {entry.path.name: entry for entry in listed(browsing, data).entries}
    assert not by_name["mine.toml"].why_not
    assert "permission" in by_name["theirs.toml"].why_not


def test_a_folder_that_cannot_be_listed_is_reported(browsing: Browsing, data: Path):
    with pytest.raises(DatasetError, match="does not exist"):
        listed(browsing, data / "gone")
    (data / "file.toml").write_text("x")
    with pytest.raises(DatasetError, match="not a folder"):
        listed(browsing, data / "file.toml")


def test_a_dataset_is_chosen_and_a_folder_of_images_can_be(browsing: Browsing, data: Path):
    (data / "w1.wafer").mkdir()
    (data / "stack").mkdir()
    for k in range(5):
        tifffile.imwrite(data / "stack" / f"{k}.tif", np.full((8, 8), 40, np.uint8))
    datasets = {e.path.name: e for e in listed(browsing, data, FILE_KINDS["dataset"]).entries}
    assert (datasets["w1.wafer"].kind, datasets["w1.wafer"].is_folder) == ("Dataset", False)
    assert (datasets["stack"].is_folder, datasets["stack"].can_choose) == (True, False)
    images = {e.path.name: e for e in listed(browsing, data, FILE_KINDS["images"]).entries}
    assert (images["stack"].is_folder, images["stack"].can_choose, images["stack"].note) == (True, True, "5 images")
    assert "w1.wafer" not in images


def test_images_and_folders_of_them_have_a_small_picture(browsing: Browsing, data: Path):
    (data / "stack").mkdir()
    ramp = np.tile(np.linspace(0, 60000, 400).astype(np.uint16), (300, 1))
    for k in range(3):
        tifffile.imwrite(data / "stack" / f"{k}.tif", ramp)
    tifffile.imwrite(data / "pages.tif", np.stack([ramp, ramp, ramp]), photometric="minisblack")
    (data / "damaged.tif").write_text("no picture")
    for path in (data / "stack" / "1.tif", data / "pages.tif", data / "stack"):
        jpeg = browsing.look(path).result(WAIT_S)
        picture = PIL.Image.open(io.BytesIO(jpeg))
        assert max(picture.size) <= 96
        assert picture.getextrema()[1] > 200
        assert len(jpeg) < 6000
    assert browsing.look(data / "damaged.tif").result(WAIT_S) == b""
    assert browsing.look(data / "stack").result(WAIT_S) is browsing.look(data / "stack").result(WAIT_S)


def test_what_was_taken_last_is_offered_first_also_after_a_restart(browsing: Browsing, data: Path):
    for name in ("a.toml", "b.toml", "gone.toml"):
        (data / name).write_text("x")
        browsing.remember("plan", data / name)
    (data / "gone.toml").unlink()
    assert listed(browsing, data, FILE_KINDS["plan"]).recent == (data / "b.toml", data / "a.toml")
    browsing.close()
    again = Browsing(data, home=None)
    try:
        assert listed(again, data, FILE_KINDS["plan"]).recent == (data / "b.toml", data / "a.toml")
        assert listed(again, data, FILE_KINDS["klarf"]).recent == ()
    finally:
        again.close()


def test_a_file_is_saved_under_the_name_typed_inside_of_the_roots(browsing: Browsing, data: Path, tmp_path: Path):
    (data / "out").mkdir()
    assert saved_as(browsing, "part", data / "out", ".gsf") == data / "out" / "part.gsf"
    assert saved_as(browsing, "part.gsf", data, ".gsf") == data / "part.gsf"
    assert saved_as(browsing, str(data / "out" / "p.gsf"), data, ".gsf") == data / "out" / "p.gsf"
    with pytest.raises(DatasetError, match="no name"):
        saved_as(browsing, "  ", data, ".gsf")
    with pytest.raises(DatasetError, match="--browse"):
        saved_as(browsing, str(tmp_path / "x.gsf"), data, ".gsf")
    with pytest.raises(DatasetError, match="does not exist"):
        saved_as(browsing, str(data / "nowhere" / "x.gsf"), data, ".gsf")
