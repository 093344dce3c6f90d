"""Support file: it holds what helps, and no secret that lay in what it was made of."""

from __future__ import annotations

import zipfile
from pathlib import Path

import pytest

from tests.support.datasets.complete_dataset import complete_dataset
from wafer_viewer.cli.app import main
from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.rigs.rig_config import RigConfig
from wafer_viewer.session.core.environment_check import EnvironmentCheck
from wafer_viewer.session.files.support_bundle import Redaction, require_zip, viewer_log, write_bundle

NAMES = Redaction("/home/mueller", "mueller", "fab3-scope")
TOKEN = "Zk3vN0tT0BeSeenByAnybody_-abcdefghij"


def texts(path: Path) -> dict[str, str]:
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name).decode() for name in archive.namelist()}


@pytest.fixture
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    path = tmp_path / "viewer.log"
    monkeypatch.setenv("WAFER_VIEWER_LOG", str(path))
    assert viewer_log() == path
    return path


def test_secrets_and_names_are_taken_out(tmp_path: Path, log: Path) -> None:
    log.write_text(
        f"opened http://127.0.0.1:8080/?token={TOKEN}&x=1 by mueller at fab3-scope\n"
        f'password: "hunter2!"  secret={TOKEN}\nFileNotFoundError: /home/mueller/data/w1.wafer\n'
        "-----BEGIN PRIVATE KEY-----\nMC4CAQAwBQYDK2VwBCIEIF\n-----END PRIVATE KEY-----\n"
    )
    checks = [EnvironmentCheck("Disk", "/home/mueller/wafer-viewer: 5 GB", "make space")]
    held = write_bundle(tmp_path / "support.zip", checks, RigConfig(), names=NAMES)
    found = texts(tmp_path / "support.zip")
    assert set(held) == set(found) == {"environment.txt", "system.txt", "packages.txt", "rig.toml", "log/viewer.log"}
    whole = "".join(found.values())
    for secret in (TOKEN, "hunter2", "MC4CAQ", "mueller", "fab3-scope"):
        assert secret not in whole
    assert "~/data/w1.wafer" in found["log/viewer.log"]
    assert "&x=1 by [user] at [machine]" in found["log/viewer.log"]
    assert "FIX  Disk: ~/wafer-viewer: 5 GB\n     mend: make space" in found["environment.txt"]
    assert "numpy " in found["packages.txt"]
    assert 'kind = "virtual"' in found["rig.toml"]


@pytest.mark.slow
def test_keys_and_tokens_of_the_data_folder_are_not_read(tmp_path: Path, log: Path, capsys) -> None:
    from wafer_viewer.session.core.audit_trail import record
    from wafer_viewer.session.core.private_file import page_token

    data = tmp_path / "data"
    token = page_token(data)
    record(data, "Result kept", "w1.wafer")
    log.write_text(f"GET /?token={token}\n")
    assert main(["bundle", "--out", str(tmp_path / "s.zip"), "--data", str(data)]) == 0
    assert "log/viewer.log" in capsys.readouterr().out
    whole = "".join(texts(tmp_path / "s.zip").values())
    assert token not in whole
    assert "PRIVATE" not in whole


@pytest.mark.slow
def test_records_of_a_named_dataset_are_in_it_and_no_frames(tmp_path: Path, log: Path) -> None:
    scanned = complete_dataset(tmp_path / "w1.wafer")
    words = ["bundle", "--out", str(tmp_path / "s.zip"), "--data", str(tmp_path), "--dataset", str(scanned)]
    assert main(words) == 0
    found = texts(tmp_path / "s.zip")
    assert {"dataset/scan.json", "dataset/journal.jsonl", "dataset/files.txt"} <= set(found)
    assert "frames/r0000c0000.tif" in found["dataset/files.txt"]
    assert not any(name.endswith((".tif", ".npz")) for name in found)


def test_what_cannot_be_written_or_is_no_dataset_is_one_sentence(tmp_path: Path, log: Path) -> None:
    with pytest.raises(WaferViewerError, match=r"let it end in \.zip"):
        require_zip(tmp_path / "support.tar")
    with pytest.raises(DatasetError):
        write_bundle(tmp_path / "s.zip", (), RigConfig(), dataset=tmp_path / "none.wafer", names=NAMES)
    assert not (tmp_path / "s.zip").exists()
