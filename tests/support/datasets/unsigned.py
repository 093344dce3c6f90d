"""Datasets as versions without manifests left them."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

from wafer_viewer.store.records.manifest import MANIFEST, MARKS
from wafer_viewer.store.records.signed_log import KEPT_IN

_DIGEST = re.compile(rb',"before":"[0-9a-f]{64}"')
_CHECKSUM = re.compile(rb',"crc32c":"[0-9a-f]{8}"')


def without_manifests(dataset: Path) -> None:
    """Remove the manifests of a dataset, and their marks."""
    for path in dataset.rglob(MANIFEST):
        path.unlink()
    shutil.rmtree(dataset.parent / KEPT_IN / MARKS / dataset.name, ignore_errors=True)


def without_digests(journal: bytes) -> bytes:
    """Return a journal without checksums and without the digests of its passes."""
    return _DIGEST.sub(b"", _CHECKSUM.sub(b"", journal))
