"""Results in the Q-DAS transfer format: every line a K field, values with limits, and dies as values of a feature."""

from __future__ import annotations

import codecs
import re
from collections import defaultdict
from datetime import datetime

import pytest

from tests.session.reporting.test_report_contents import KINDS, RESULT
from tests.session.reporting.test_report_contents import dataset as dataset
from wafer_viewer.cli.app import main
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.tables.aqdef import NOT_VALID, ControlledQuantity, MeasuredPart, MeasuredValue, transfer_file

LINE = re.compile(r"(K\d{4})(?:/(\d+))? (.+)")


def fields_of(content):
    """Return the texts by K field and number of part or characteristic, as a reader of the format takes them."""
    found = defaultdict(list)
    utf_8 = content.startswith(codecs.BOM_UTF8)
    for line in content.decode("utf-8-sig" if utf_8 else "cp1252").split("\r\n")[:-1]:
        key, n, text = LINE.fullmatch(line).groups()
        found[key, int(n or 0)].append(text)
    return found


@pytest.fixture
def fields(dataset, tmp_path):
    assert main(["report", str(dataset), "-o", str(tmp_path / "wafer.dfq")]) == 0
    return fields_of((tmp_path / "wafer.dfq").read_bytes())


def test_a_feature_has_its_limits_and_a_value_for_each_die(fields):
    assert [fields[key, 1] for key in ("K2001", "K2002", "K2142")] == [["F1"], ["die over street"], ["µm"]]
    assert [fields[key, 1] for key in ("K2110", "K2111")] == [["11"], ["12.5"]]
    assert [float(text) for text in fields["K0001", 1]] == pytest.approx([12.3, 12.3], abs=0.05)
    assert fields["K0002", 1] == ["0", "0"]
    assert [text.partition(", ")[2] for text in fields["K0014", 1]] == ["die 0,0", "die 0,<1>"]
    assert all(re.fullmatch(r"12\.\d+ ± 0\.\d+ µm; k = \d\.\d\d; pass", text) for text in fields["K0009", 1])


def test_every_quantity_of_every_result_follows_without_limits(fields, dataset):
    findings = Dataset.open(dataset).result(RESULT).findings().items
    quantities = [quantity for finding in findings for quantity in finding.quantities.values()]
    assert fields["K0100", 0] == [str(1 + len(quantities))]
    values = [float(fields["K0001", n][0]) for n in range(2, 2 + len(quantities))]
    assert values == pytest.approx([quantity.value for quantity in quantities], rel=1e-8, abs=1e-12)
    names = [fields["K2002", n][0] for n in range(2, 2 + len(quantities))]
    assert len(set(names)) == len(names)
    assert names[0].startswith(f"{KINDS[0][0]} 1, ")
    assert not any(("K2110", n) in fields for n in range(2, 2 + len(quantities)))


def test_the_part_has_its_wafer_lot_and_time(fields, dataset):
    assert fields["K1001", 1] == ["coupon"]
    assert set(fields["K0006", 1]) == {Dataset.open(dataset).scan.job.sample.lot}
    taken = datetime.fromisoformat(Dataset.open(dataset).scan.taken)
    assert datetime.strptime(fields["K0004", 1][0], "%d.%m.%Y/%H:%M:%S") == taken.replace(tzinfo=None, microsecond=0)


def test_a_simulated_part_says_so(dataset, tmp_path, monkeypatch):
    monkeypatch.setattr(Dataset, "simulated", True)
    assert main(["report", str(dataset), "-o", str(tmp_path / "wafer.dfq")]) == 0
    assert fields_of((tmp_path / "wafer.dfq").read_bytes())["K1900", 1] == ["SIMULATED"]


def part(values, name="step", lot="", part_name="wafer"):
    step = ControlledQuantity("1", name, "µm", values, lower=-0.5)
    return MeasuredPart("P", part_name, "", "", "", lot, None, [step])


def test_what_was_not_measured_is_a_value_that_counts_nowhere():
    fields = fields_of(transfer_file(part([MeasuredValue(None, "W1", "not measured: no place"), MeasuredValue(2.0)])))
    assert fields["K0002", 1] == [str(NOT_VALID), "0"]
    assert fields["K0001", 1] == ["0", "2"]
    assert fields["K2110", 1] == ["-0.5"]
    assert ("K0004", 1) not in fields


@pytest.mark.parametrize(
    ("value", "text"), [(1e-7, "0.0000001"), (399.88, "399.88"), (-0.0, "0"), (123456789.125, "123456789")]
)
def test_numbers_have_no_exponent(value, text):
    assert fields_of(transfer_file(part([MeasuredValue(value)])))["K0001", 1] == [text]


def test_a_name_can_neither_end_a_line_nor_begin_a_field():
    fields = fields_of(transfer_file(part([MeasuredValue(1.0)], name="a\r\nK2111/1 99\x0fb\x14")))
    assert fields["K2002", 1] == ["a K2111/1 99 b"]
    assert ("K2111", 1) not in fields


def test_a_lot_too_long_for_its_field_stands_in_the_text_whole_and_other_letters_make_it_utf_8():
    short = transfer_file(part([MeasuredValue(1.0)], lot="L7", part_name="Ø 5 µm"))
    assert not short.startswith(codecs.BOM_UTF8)
    assert fields_of(short)["K0006", 1] == ["L7"]
    content = transfer_file(part([MeasuredValue(1.0)], lot="2026-11-lot-of-silicon", part_name="Ω晶圆"))
    assert content.startswith(codecs.BOM_UTF8)
    assert fields_of(content)["K0009", 1] == ["lot 2026-11-lot-of-silicon"]
    assert fields_of(content)["K1002", 1] == ["Ω晶圆"]
