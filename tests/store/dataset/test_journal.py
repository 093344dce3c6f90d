from __future__ import annotations

import itertools
from pathlib import Path

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.campaigns import examples
from wafer_viewer.model.acquisition.plan import Shot
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.dataset import scan_record
from wafer_viewer.store.dataset.scan_record import FaultNoted, FrameKept, JournalReader, JournalWriter, Missed, Repaired
from wafer_viewer.store.io.atomic_files import natural_sort_key

NUMBERS = st.floats(-1e6, 1e6)
COUNTS = st.integers(0, 2**31)
SHOTS = st.builds(Shot, field=COUNTS, k=COUNTS, exposure=st.integers(0, 3))
FRAMES = st.builds(
    FrameKept,
    shot=SHOTS,
    pulse_count=st.integers(-(2**40), 2**40),
    x_um=NUMBERS,
    y_um=NUMBERS,
    z_um=NUMBERS,
    exposure_us=NUMBERS,
    device_time_us=COUNTS,
    crc32=st.integers(0, 2**32 - 1),
)
NOTES = st.builds(FaultNoted, what=st.text(), time=st.text(max_size=5))
LINES = st.lists(st.one_of(FRAMES, NOTES, st.builds(Missed, shot=SHOTS, pulse_count=COUNTS, why=st.text())), max_size=6)


def read(path: Path):
    return list(JournalReader(path).new_lines())


@pytest.fixture(scope="module")
def journal(tmp_path_factory):
    return tmp_path_factory.mktemp("journal") / "journal.jsonl"


@given(lines=LINES, cut=st.integers(0, 3000), more=FRAMES)
@settings(max_examples=examples(80))
def test_wherever_a_journal_is_torn_its_whole_lines_are_read_and_it_continues(journal, lines, cut, more):
    journal.unlink(missing_ok=True)
    writer = JournalWriter(journal)
    for line in lines:
        writer.write(line)
    writer.close()
    assert read(journal) == lines
    text = journal.read_bytes()[:cut]
    journal.write_bytes(text)
    survivors = lines[: text.count(b"\n")]
    assert read(journal) == survivors
    writer = JournalWriter(journal)
    writer.write(more)
    writer.close()
    assert read(journal) == [*survivors, more]


def test_a_line_is_read_once_it_is_whole(journal):
    line = Repaired(Shot(1, 2))
    text = msgspec.json.encode(line) + b"\n"
    journal.write_bytes(text + text[:9])
    reader = JournalReader(journal)
    assert list(reader.new_lines()) == [line]
    assert list(reader.new_lines()) == []
    with journal.open("ab") as file:
        file.write(text[9:])
    assert list(reader.new_lines()) == [line]


@pytest.fixture
def long_journal(journal, monkeypatch):
    """A journal of many parts, and its lines."""
    monkeypatch.setattr(scan_record, "_BATCH_BYTES", 1000)
    lines = [Repaired(Shot(n, n % 7)) for n in range(200)]
    journal.unlink(missing_ok=True)
    writer = JournalWriter(journal)
    for line in lines:
        writer.write(line)
    writer.close()
    return journal, lines


def test_a_long_journal_is_read_in_parts(long_journal):
    journal, lines = long_journal
    assert journal.stat().st_size > 10_000
    assert read(journal) == lines
    content = journal.read_bytes()
    journal.write_bytes(content[:-5])
    assert read(journal) == lines[:-1]
    plain = b"".join(msgspec.json.encode(line) + b"\n" for line in lines)
    journal.write_bytes(plain)
    assert read(journal) == lines, "journals of schema 1 may have no checksums"


@pytest.mark.parametrize("number", [1, 57, 199])
def test_a_damaged_line_of_a_long_journal_is_named_and_those_before_it_are_read(long_journal, number):
    journal, lines = long_journal
    texts = journal.read_bytes().split(b"\n")
    texts[number - 1] = texts[number - 1].replace(b"repaired", b"repaireb")
    journal.write_bytes(b"\n".join(texts))
    reader = JournalReader(journal).new_lines()
    assert list(itertools.islice(reader, number - 1)) == lines[: number - 1]
    with pytest.raises(DatasetError, match=f"is damaged in line {number}:"):
        next(reader)


def test_a_line_of_an_unknown_kind_is_damage(journal):
    good = msgspec.json.encode(Repaired(Shot(1, 2))) + b"\n"
    journal.write_bytes(b'{"type": "unheard_of"}\n' + good)
    with pytest.raises(DatasetError, match="is damaged in line 1"):
        read(journal)


@given(st.lists(st.integers(0, 10**6), min_size=1, unique=True))
def test_names_are_sorted_as_people_count(numbers):
    names = [f"im{n}.tif" for n in numbers]
    assert sorted(names, key=natural_sort_key) == [f"im{n}.tif" for n in sorted(numbers)]


def test_any_names_can_be_sorted():
    assert sorted(["b", "²", "10", "", "2x", "٣", "A"], key=natural_sort_key) == ["", "2x", "٣", "10", "A", "b", "²"]
