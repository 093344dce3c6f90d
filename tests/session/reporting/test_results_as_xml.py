"""Results as a digital calibration certificate: its parts in the order of the schema, and values with their U."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import pytest

from tests.session.reporting.test_report_contents import KINDS, RESULT
from tests.session.reporting.test_report_contents import dataset as dataset
from wafer_viewer.cli.app import main
from wafer_viewer.store.dataset.dataset import Dataset

NAMES = {"dcc": "https://ptb.de/dcc", "si": "https://ptb.de/si"}
ORDER = {
    "administrativeData": (
        *("dccSoftware", "coreData", "items", "calibrationLaboratory", "respPersons", "customer", "statements"),
    ),
    "coreData": (
        *("countryCodeISO3166_1", "usedLangCodeISO639_1", "mandatoryLangCodeISO639_1", "uniqueIdentifier"),
        *("beginPerformanceDate", "endPerformanceDate", "performanceLocation"),
    ),
    "item": ("name", "manufacturer", "identifications"),
    "contact": ("name", "eMail", "location"),
    "measurementResult": ("name", "results"),
    "result": ("name", "description", "data"),
    "real": ("label", "value", "unit", "expandedUnc"),
    "expandedUnc": ("uncertainty", "coverageFactor", "coverageProbability"),
}
"""Parts of DCC 3.1.2 and D-SI 2.1.0 in the order that their schemas ask for."""


@pytest.fixture
def root(dataset, tmp_path):
    laboratory = dataset.parent / "laboratory.toml"
    laboratory.write_text('name = "Labor <1>"\ncountry = "DE"\naddress = "Dresden"\n')
    try:
        assert main(["report", str(dataset), "-o", str(tmp_path / "r.xml"), "--customer", "A & B"]) == 0
    finally:
        laboratory.unlink()
    return ET.parse(tmp_path / "r.xml").getroot()


def short(element):
    return element.tag.partition("}")[2]


def test_parts_come_in_the_order_of_the_schema(root):
    assert root.get("schemaVersion") == "3.1.2"
    assert [short(part) for part in root] == ["administrativeData", "measurementResults"]
    for element in root.iter():
        if (wanted := ORDER.get(short(element))) is not None:
            found = tuple(short(part) for part in element)
            assert found == tuple(name for name in wanted if name in found), short(element)
            assert set(wanted) - set(found) <= {"expandedUnc"}


def test_every_quantity_has_its_value_unit_and_u(root, dataset):
    results = root.findall(".//dcc:result", NAMES)
    findings = Dataset.open(dataset).result(RESULT).findings().items
    assert len(results) == len(findings) == len(KINDS)
    for result, finding in zip(results, findings, strict=True):
        assert result.findtext("dcc:name/dcc:content", None, NAMES) == finding.name
        reals = {real.findtext("si:label", None, NAMES): real for real in result.iter(f"{{{NAMES['si']}}}real")}
        assert set(reals) == set(finding.quantities)
        for name, quantity in finding.quantities.items():
            real = reals[name]
            assert float(real.findtext("si:value", None, NAMES)) == pytest.approx(quantity.value, rel=1e-8)
            if quantity.expanded is not None:
                u, k = (
                    float(real.findtext(f"si:expandedUnc/si:{part}", None, NAMES))
                    for part in ("uncertainty", "coverageFactor")
                )
                assert (u, k) == pytest.approx((quantity.expanded, quantity.k), rel=1e-8)
    units = {real.findtext("si:unit", None, NAMES) for real in root.iter(f"{{{NAMES['si']}}}real")}
    assert {r"\micro\metre", r"\micro\metre\tothe{3}", r"\degree"} <= units


def test_laboratory_customer_and_warnings_are_in_it(root):
    assert root.findtext(".//dcc:calibrationLaboratory//dcc:content", None, NAMES) == "Labor <1>"
    assert root.findtext(".//dcc:customer//dcc:content", None, NAMES) == "A & B"
    told = [element.text for element in root.findall(".//dcc:statement//dcc:content", NAMES)]
    assert any(text.startswith("Verdict: PASS") for text in told)
    assert any(text.startswith("Not evaluated in U of") for text in told)


def test_without_a_laboratory_it_is_refused_in_one_sentence(dataset, tmp_path, capsys):
    assert main(["report", str(dataset), "-o", str(tmp_path / "r.xml")]) == 2
    assert "laboratory.toml of the data folder gives no name and country" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
