"""Frame numbers as a counter."""

from __future__ import annotations

from wafer_viewer.rigs.cameras.base import FrameNumbers


def counts(*ids):
    numbers = FrameNumbers()
    return [numbers.count(i) for i in ids]


def test_a_run_counts_from_0_and_keeps_gaps():
    assert counts(1, 2, 5, 6) == [0, 1, 4, 5]
    assert counts(417, 418) == [0, 1]


def test_numbers_of_16_bits_go_on_with_1():
    assert counts(65534, 65535, 1, 2) == [0, 1, 2, 3]
    assert counts(65530, 3) == [0, 8]


def test_numbers_of_64_bits_do_not_wrap():
    assert counts(65535, 65536, 70000) == [0, 1, 4465]


def test_incomplete_frames_before_the_first_complete_one_count():
    numbers = FrameNumbers()
    numbers.skip()
    numbers.skip()
    assert numbers.count(3) == 2
    numbers.skip()
    assert numbers.count(5) == 4
