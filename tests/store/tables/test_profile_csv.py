from __future__ import annotations

import csv

import numpy as np

from tests.support.made_up_sections import hill, section_of
from wafer_viewer.store.tables.csv_tables import profiles_csv


def read(text: str) -> tuple[list[str], dict[str, np.ndarray]]:
    lines = text.splitlines()
    heads = [line for line in lines if line.startswith("#")]
    rows = list(csv.reader(lines[len(heads) :]))
    columns = zip(*rows[1:], strict=True)
    return heads, {
        name: np.array([float(v) for v in column if v]) for name, column in zip(rows[0], columns, strict=True)
    }


def test_a_table_gives_back_every_curve_with_its_places():
    z = hill(500)
    z[40:60] = np.nan
    first, second = section_of(z), section_of(hill(300), 1)
    heads, columns = read(profiles_csv([first, second], "1.2"))
    np.testing.assert_allclose(columns["A distance_um"], first.curve.distance_um, atol=1e-4)
    np.testing.assert_allclose(columns["A z_um"], z[np.isfinite(z)], atol=1e-4)
    np.testing.assert_allclose(columns["B y_um"], second.curve.y_um, atol=1e-4)
    assert len(columns["B z_um"]) == 300
    assert "SIMULATED" in heads[1]
    assert "coupon-07" in heads[2]
    assert "levelled by stage" in heads[2]
    assert "measured heights" in heads[2]


def test_a_real_surface_is_not_called_simulated():
    heads, _ = read(profiles_csv([section_of(hill(), simulated=False)], "1.2"))
    assert "SIMULATED" not in "".join(heads)
    assert "; real;" in heads[1]
