"""Signed logs against people who know the format, can compute every checksum and digest, and do not have the key."""

from __future__ import annotations

import copy
import hashlib
import json
import multiprocessing
import random
import shutil
from typing import ClassVar

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.model.spec import Spec
from wafer_viewer.store.io.checksums import sealed_line, strip_checksum
from wafer_viewer.store.records import signed_log
from wafer_viewer.store.records.signed_log import (
    KEPT_IN,
    KEY_FILE,
    KNOWN_KEYS,
    append_record,
    known_public_key,
    log_lengths,
    read_log,
    signing_key,
)

N_RECORDS, N_TAMPERINGS = 12, 1000


class Entry(Spec, frozen=True, kw_only=True):
    error: ClassVar[type[WaferViewerError]] = DatasetError
    by: str
    error_um: float


def entry(n):
    return Entry(by=f"Operator {n}", error_um=0.01 * n)


@pytest.fixture(scope="module")
def signed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("signed")
    for n in range(N_RECORDS):
        append_record(folder / "log.jsonl", entry(n))
    return folder


@pytest.fixture
def folder(signed, tmp_path):
    return shutil.copytree(signed, tmp_path / "data")


def lines_of(folder):
    return [json.loads(strip_checksum(line)) for line in (folder / "log.jsonl").read_bytes().splitlines()]


def write_lines(folder, lines, *, link_again=False, key=None):
    """Write lines with right checksums; link_again: with right digests; key: with signatures of another key."""
    content = b""
    for line in lines:
        before, text = hashlib.sha256(content), {name: value for name, value in line.items() if name != "link"}
        link = dict(line.get("link", {}))
        if link and (link_again or key is not None):
            link["after"] = before.hexdigest()
        if key is not None:
            value = key.sign(before.digest() + as_bytes(text)).hex()
            link = {"after": before.hexdigest(), "key": key.public_key().public_bytes_raw().hex(), "signature": value}
        content += sealed_line(as_bytes({**text, "link": link} if link else text)) + b"\n"
    (folder / "log.jsonl").write_bytes(content)


def as_bytes(line):
    return json.dumps(line, separators=(",", ":")).encode()


def change_a_value(lines, rng):
    line = rng.choice(lines)
    line.update(rng.choice([{"by": "Somebody else"}, {"error_um": line["error_um"] + rng.uniform(0.001, 1)}]))


def remove_lines(lines, rng):
    start = rng.randrange(len(lines))
    del lines[start : start + rng.randint(1, 3)]


def insert_a_line(lines, rng):
    made_up = {**rng.choice(lines), "by": "Somebody else"}
    lines.insert(rng.randrange(len(lines) + 1), rng.choice([made_up, dict(rng.choice(lines))]))


def swap_lines(lines, rng):
    i, j = rng.sample(range(len(lines)), 2)
    lines[i], lines[j] = lines[j], lines[i]


def strip_signatures(lines, rng):
    change_a_value(lines, rng)
    for line in lines[rng.randrange(len(lines)) :]:
        line.pop("link", None)


def take_links_of_others(lines, rng):
    a, b = rng.sample(lines, 2)
    a["by"] = "Somebody else"
    a["link"] = dict(b["link"])


def strip_all_signatures(lines, rng):
    change_a_value(lines, rng)
    for line in lines:
        line.pop("link", None)


TAMPERINGS = (
    change_a_value,
    remove_lines,
    insert_a_line,
    swap_lines,
    strip_signatures,
    strip_all_signatures,
    take_links_of_others,
)


@pytest.mark.slow
def test_every_tampering_with_records_is_found(folder):
    rng, foreign, originals = random.Random(1), Ed25519PrivateKey.generate(), lines_of(folder)
    head = folder / KEPT_IN / "log.jsonl.head"
    signed_head = head.read_bytes()
    missed = []
    for n in range(N_TAMPERINGS):
        lines, tamper = copy.deepcopy(originals), rng.choice(TAMPERINGS)
        tamper(lines, rng)
        write_lines(folder, lines, link_again=rng.random() < 0.5, key=rng.choice([None, None, foreign]))
        head.write_bytes(signed_head)
        if rng.random() < 0.3:
            head.unlink()
        try:
            read_log(folder / "log.jsonl", Entry)
        except DatasetError:
            continue
        missed.append((n, tamper.__name__))
    assert missed == []


def test_the_untouched_log_is_good_also_in_a_copy_without_the_key(folder, signed):
    (folder / KEPT_IN / KEY_FILE).unlink()
    for place in (signed, folder):
        log = read_log(place / "log.jsonl", Entry)
        assert log.records == tuple(entry(n) for n in range(N_RECORDS))
        assert log.keys == (known_public_key(signed),)


@pytest.mark.parametrize("name", ["log.jsonl", f"{KEPT_IN}/log.jsonl.head"])
def test_every_flipped_bit_is_found(folder, name):
    path = folder / name
    content = path.read_bytes()
    rng = random.Random(2)
    for _ in range(200):
        at = rng.randrange(len(content) - 1)
        changed = bytes([content[at] ^ (1 << rng.randrange(8))])
        path.write_bytes(content[:at] + changed + content[at + 1 :])
        with pytest.raises(DatasetError):
            read_log(folder / "log.jsonl", Entry)


def test_what_was_done_is_said(folder):
    lines = lines_of(folder)
    write_lines(folder, lines[:-2])
    with pytest.raises(DatasetError, match="was altered: it has 10 lines, and had 12: the last were removed"):
        read_log(folder / "log.jsonl", Entry)
    write_lines(folder, [{**line, "by": "X"} if n == 4 else line for n, line in enumerate(lines)])
    with pytest.raises(DatasetError, match="signature of line 5 does not fit its contents"):
        read_log(folder / "log.jsonl", Entry)
    write_lines(folder, lines[:3] + lines[4:])
    with pytest.raises(DatasetError, match="line 4 does not follow the lines before it"):
        read_log(folder / "log.jsonl", Entry)
    with pytest.raises(DatasetError, match="line 4 does not follow"):
        append_record(folder / "log.jsonl", entry(99))
    write_lines(folder, lines)
    (folder / KEPT_IN / "log.jsonl.head").unlink()
    with pytest.raises(DatasetError, match=r"its head .* is missing"):
        read_log(folder / "log.jsonl", Entry)


def test_a_log_of_another_key_needs_to_be_trusted(folder):
    old = known_public_key(folder)
    (folder / KEPT_IN / KEY_FILE).unlink()
    signing_key(folder)
    with pytest.raises(DatasetError, match=f"signed with the key {old}, which is not the key of this folder"):
        read_log(folder / "log.jsonl", Entry)
    (folder / KNOWN_KEYS).write_text(f"{old.upper()} the key until the machine was replaced\n")
    append_record(folder / "log.jsonl", entry(99))
    assert read_log(folder / "log.jsonl", Entry).keys == (old, known_public_key(folder))


@pytest.mark.parametrize("without_key", [False, True])
def test_log_without_signatures_and_head_is_altered(folder, without_key):
    lines = [{name: value for name, value in line.items() if name != "link"} for line in lines_of(folder)]
    write_lines(folder, lines)
    (folder / KEPT_IN / "log.jsonl.head").unlink()
    if without_key:
        (folder / KEPT_IN / KEY_FILE).unlink()
    with pytest.raises(DatasetError, match=r"log\.jsonl was altered: line 1 is not signed"):
        read_log(folder / "log.jsonl", Entry)
    with pytest.raises(DatasetError, match="line 1 is not signed"):
        append_record(folder / "log.jsonl", entry(99))


def test_lengths_of_logs_are_those_of_their_own_heads(folder):
    append_record(folder / "other.jsonl", entry(0))
    assert log_lengths(folder) == {"log.jsonl": N_RECORDS, "other.jsonl": 1}
    head = folder / KEPT_IN / "log.jsonl.head"
    head.write_bytes(head.read_bytes().replace(b'"lines": 12', b'"lines": 92'))
    assert log_lengths(folder) == {"other.jsonl": 1}
    (folder / KEPT_IN / KEY_FILE).unlink()
    assert log_lengths(folder) == {}


def test_a_crash_before_the_head_was_written_loses_nothing(folder):
    head = folder / KEPT_IN / "log.jsonl.head"
    before = head.read_bytes()
    append_record(folder / "log.jsonl", entry(12))
    head.write_bytes(before)
    assert len(read_log(folder / "log.jsonl", Entry).records) == 13
    append_record(folder / "log.jsonl", entry(13))
    assert len(read_log(folder / "log.jsonl", Entry).records) == 14


def test_a_crash_before_the_first_head_was_written_loses_nothing(tmp_path, monkeypatch):
    path, save, saved = tmp_path / "log.jsonl", signed_log.save_json, []

    def save_until_the_line_is_there(file, spec):
        if path.exists():
            raise KeyboardInterrupt
        saved.append(spec)
        save(file, spec)

    monkeypatch.setattr(signed_log, "save_json", save_until_the_line_is_there)
    with pytest.raises(KeyboardInterrupt):
        append_record(path, entry(0))
    monkeypatch.undo()
    assert [head.lines for head in saved] == [0]
    assert len(read_log(path, Entry).records) == 1
    append_record(path, entry(1))
    assert len(read_log(path, Entry).records) == 2


def _append_some(path, first):
    for n in range(first, first + 10):
        append_record(path, entry(n))


@pytest.mark.slow
def test_programs_that_sign_at_once_wait_for_each_other(tmp_path):
    path = tmp_path / "log.jsonl"
    append_record(path, entry(0))
    processes = [multiprocessing.get_context("spawn").Process(target=_append_some, args=(path, n)) for n in (10, 20)]
    for process in processes:
        process.start()
    for process in processes:
        process.join(60)
        assert process.exitcode == 0
    assert len(read_log(path, Entry).records) == 21
