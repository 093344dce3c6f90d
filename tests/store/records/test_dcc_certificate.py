"""Certificates of gauge blocks as DCC: lengths, U, k and serial numbers read, unfit files refused by element."""

from __future__ import annotations

import datetime

import pytest

from tests.support import paths
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.store.records.calibration_records import read_certificate

ASSETS = paths.ASSETS / "gauge"
TEXT = (ASSETS / "virtual-blocks.xml").read_text()
UNC = "<si:uncertainty>0.00006</si:uncertainty><si:coverageFactor>2</si:coverageFactor>"
NEW_UNC = (
    "<si:measurementUncertaintyUnivariate><si:expandedMU><si:valueExpandedMU>0.00006</si:valueExpandedMU>"
    "<si:coverageFactor>2</si:coverageFactor></si:expandedMU></si:measurementUncertaintyUnivariate>"
)
LISTS = r"""<dcc:result><dcc:data><dcc:list>
<dcc:quantity><dcc:name><dcc:content lang="de">Nennmaß</dcc:content></dcc:name><si:realListXMLList>
<si:valueXMLList>1.4 1.0</si:valueXMLList><si:unitXMLList>\milli\metre</si:unitXMLList>
</si:realListXMLList></dcc:quantity>
<dcc:quantity><dcc:name><dcc:content lang="de">Abweichung</dcc:content></dcc:name><si:realListXMLList>
<si:valueXMLList>-60 60</si:valueXMLList><si:unitXMLList>\nano\metre</si:unitXMLList>
<si:expandedUncXMLList><si:uncertaintyXMLList>90 90</si:uncertaintyXMLList>
<si:coverageFactorXMLList>3</si:coverageFactorXMLList></si:expandedUncXMLList></si:realListXMLList></dcc:quantity>
</dcc:list></dcc:data></dcc:result>"""


def read(tmp_path, text, **settled):
    path = tmp_path / "blocks.xml"
    path.write_text(text)
    return read_certificate(path, **settled)


def with_results(text):
    """Return the example with other results."""
    head, _, rest = TEXT.partition("<dcc:results>")
    return f"{head}<dcc:results>{text}</dcc:results>{rest.partition('</dcc:results>')[2]}"


def test_the_example_says_the_same_as_that_in_toml():
    found, same = (read_certificate(ASSETS / f"virtual-blocks.{kind}") for kind in ("xml", "toml"))
    assert [(b.serial_number, b.nominal_um) for b in found.blocks] == [
        (b.serial_number, b.nominal_um) for b in same.blocks
    ]
    assert found.step.value_um == pytest.approx(same.step.value_um)
    assert found.step.expanded_um == pytest.approx(same.step.expanded_um)
    assert (found.number, found.issued, found.expires.year) == ("EXAMPLE-3", datetime.date(2026, 1, 5), 2099)


def test_lists_of_deviations_with_k_3_are_lengths_with_k_2(tmp_path):
    found = read(tmp_path, with_results(LISTS))
    assert [b.value_um for b in found.blocks] == pytest.approx([1399.94, 1000.06])
    assert [b.expanded_um for b in found.blocks] == pytest.approx([0.06, 0.06])


def test_the_uncertainty_of_newer_schemas_is_read(tmp_path):
    newer = TEXT.replace("<si:expandedUnc>", "").replace("</si:expandedUnc>", "")
    newer = newer.replace(UNC, NEW_UNC).replace("<si:coverageProbability>0.95</si:coverageProbability>", "")
    assert read(tmp_path, newer).step.expanded_um == pytest.approx(0.06 * 2**0.5)


def test_one_item_is_a_step(tmp_path):
    first = TEXT.index('<dcc:item id="block2">')
    text = TEXT[:first] + TEXT[TEXT.index("</dcc:items>") :]
    first = text.index('<dcc:result refId="block2">')
    text = text[:first] + text[text.index("</dcc:results>") :]
    found = read(
        tmp_path, text.replace("V-1400", "V-1400/V-1000").replace("1.39994", "0.39988").replace(">1.4<", ">0.4<")
    )
    assert (found.value_um, found.serials) == (pytest.approx(399.88), ("V-1000", "V-1400"))


def test_two_of_more_blocks_are_chosen_and_a_due_day_is_given(tmp_path):
    third = LISTS.replace("1.4 1.0", "1.4 1.0 2.0").replace("-60 60", "-60 60 0").replace("90 90", "90 90 90")
    text = with_results(third).replace(
        "</dcc:items>",
        "<dcc:item><dcc:identifications><dcc:identification><dcc:issuer>manufacturer</dcc:issuer>"
        "<dcc:value>V-2000</dcc:value></dcc:identification></dcc:identifications></dcc:item></dcc:items>",
    )
    with pytest.raises(MeasureError, match="3 blocks in dcc:items, V-1400, V-1000, V-2000: choose two by --blocks"):
        read(tmp_path, text)
    found = read(tmp_path, text, blocks=("V-2000", "V-1400"), expires=datetime.date(2027, 1, 5))
    assert (found.step_nominal_um, found.expires) == (600.0, datetime.date(2027, 1, 5))
    with pytest.raises(MeasureError, match="has no block V-1 in dcc:items"):
        read(tmp_path, text, blocks=("V-1", "V-1400"))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("P73Y", "P99999Y", "has 'P99999Y' as dcc:period, which no calendar reaches"),
        ("<dcc:period>P73Y</dcc:period>", "", "does not say until when it is valid .dcc:period of a dcc:statement"),
        (UNC, "<si:uncertainty>0.00006</si:uncertainty>", "U of 'basic_measuredValue' without si:coverageFactor"),
        (UNC, UNC.replace("0.00006", "-1"), "gives U -1 with k 2 of 'basic_measuredValue': both must be over 0"),
        ("1.39994", "one", "has 'one' as si:value of 'basic_measuredValue': it must be a number"),
        ("1.39994", "NaN", "it must be a number"),
        ("1.39994", "1399.94", "states 1.39994e[+]06 um for a nominal length of 1400 um: a unit is wrong"),
        (r"\milli\metre", r"\inch", r"in .inch: si:unit must be one of .metre"),
        ("basic_measuredValue", "basic_other", "gives no length of block V-1400"),
        ("basic_nominalValue", "basic_other", "gives no nominal length of block V-1400"),
        ("<dcc:value>V-1400</dcc:value>", "", "has a dcc:item without a serial number"),
        ("V-1400", "V-1000", "names the serial number V-1000 twice in dcc:items"),
        ("<dcc:uniqueIdentifier>EXAMPLE-3</dcc:uniqueIdentifier>", "", "has no dcc:uniqueIdentifier in coreData"),
        (
            "<dcc:endPerformanceDate>2026-01-05", "<dcc:endPerformanceDate>in May",
            "has 'in May' as dcc:endPerformanceDate: it must be a day",
        ),
        ("https://ptb.de/dcc", "https://example.org/dcc", "begins with <digitalCalibrationCertificate>, a DCC with"),
        ("?>\n", '?>\n<!DOCTYPE x [<!ENTITY a "b">]>\n', "has a DOCTYPE, which a DCC has none of"),
        ("</dcc:digitalCalibrationCertificate>", "", "is no XML"),
        ("refId=\"block2\"", "", "has 1 nominal values and 2 dcc:item: refer from each to its item by refId"),
        ("refId=\"block2\"", "refId=\"block1\"", "gives 2 nominal values of block V-1400: it must be one"),
    ],
)  # fmt: skip
def test_an_unfit_file_is_refused_and_the_element_named(tmp_path, old, new, message):
    assert old in TEXT
    with pytest.raises(MeasureError, match=message):
        read(tmp_path, TEXT.replace(old, new))


def test_a_length_that_contradicts_its_deviation_is_refused(tmp_path):
    first, second, *_ = LISTS.partition("</dcc:list>")
    measured = LISTS[LISTS.index('<dcc:quantity><dcc:name><dcc:content lang="de">Abw') : LISTS.index("</dcc:list>")]
    both = measured.replace("Abweichung", "Länge").replace("-60 60", "1399940 1000160")
    with pytest.raises(MeasureError, match=r"states 1000.16 um for block V-1000, and as deviation 1000 \+0.06 um"):
        read(tmp_path, with_results(first + both + second + "</dcc:data></dcc:result>"))
