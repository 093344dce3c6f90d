from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wafer_viewer.model.acquisition.plan import Shot
from wafer_viewer.model.errors import DatasetError
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
@settings(max_examples=80)
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
