"""Signed conformance reports: a JSON file with all figures, and beside it the page for people, whose digest it holds.

The signature (Ed25519, RFC 8032) is made with a key of the data folder. It shows that report and page were not altered
since somebody with that key signed them. It does not show who that was, nor that the figures are true.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
from markupsafe import Markup

from wafer_viewer.model.acquisition.conformance import ConformanceReport, ReportSignature, SignedConformance
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.report import PAGE, PRINTED, Report
from wafer_viewer.store.io.atomic_files import write_text
from wafer_viewer.store.io.checksums import load_json, save_json
from wafer_viewer.store.records.printed_report import print_pdf
from wafer_viewer.store.records.report_language import phrase, translated
from wafer_viewer.store.records.signed_log import is_signed, public_key

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from jinja2 import Template


# ---------------------------------------------------------------------------------------------------------- report file


TEMPLATE = "report.html.j2"


def report_html(report: Report) -> str:
    """Return the HTML text; all strings from people or files are escaped.

    Every page names the content by the first digits of the SHA-256 of the text without them.
    """
    say = partial(phrase, report.language)
    words = {say(word): word for word in ("PASS", "FAIL", "INCONCLUSIVE", "NO VERDICT")}
    text = _template().render(report=translated(report), content=_CONTENT, say=say, words=words)
    digits = hashlib.sha256(text.encode()).hexdigest()
    return text.replace(_CONTENT, " ".join(digits[k : k + 4] for k in range(0, len(_CONTENT) - 3, 5)))


_CONTENT = "0000 0000 0000 0000"


def _css_text(text: str) -> Markup:
    """Return a text as a string of a style sheet, whatever it holds."""
    return Markup("".join(c if c.isalnum() and c.isascii() else f"\\{ord(c):x} " for c in text))


def write_report(report: Report, path: Path) -> None:
    """Write the report atomically, as HTML or PDF by its ending. Raises DatasetError for another, or if it fails."""
    if path.suffix == PRINTED:
        print_pdf(report_html(report), path)
    elif path.suffix in (PAGE, ".htm"):
        write_text(path, report_html(report))
    else:
        raise DatasetError(f"{path.name} is no name of a report: give NAME{PAGE} or NAME{PRINTED}.")


RECORD = ".json"


@cache
def _template() -> Template:
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["css"] = _css_text
    return environment.get_template(TEMPLATE)


# -------------------------------------------------------------------------------------------------- conformance reports


@dataclass(frozen=True, slots=True)
class VerifiedConformance:
    """Report whose signature fits, and the public key that it fits to, hex."""

    report: ConformanceReport
    key: str


def report_paths(path: Path) -> tuple[Path, Path]:
    """Return the files of a report: record and page. Raises DatasetError for another ending."""
    if path.suffix not in (PAGE, RECORD):
        raise DatasetError(f"{path} is no name of a report: give NAME{PAGE} or NAME{RECORD}; both are written.")
    return path.with_suffix(RECORD), path.with_suffix(PAGE)


def write_signed(report: ConformanceReport, page: str, path: Path, key: Ed25519PrivateKey) -> tuple[Path, Path]:
    """Write a report and its page, signed; return both files. Raises DatasetError when they cannot be written."""
    record, page_path = report_paths(path)
    held: dict[str, Any] = msgspec.to_builtins(report)
    digest = hashlib.sha256(page.encode()).hexdigest()
    value = key.sign(_signed_bytes(held, digest)).hex()
    signature = ReportSignature(key=public_key(key), value=value)
    write_text(page_path, page)
    save_json(record, SignedConformance(report=held, page_sha256=digest, signature=signature))
    return record, page_path


def verified_report(path: Path) -> VerifiedConformance:
    """Read a report and verify it and its page. Raises DatasetError when one is missing, damaged or altered.

    path: one of the two files. The page may be missing if the record is given.
    """
    record, page = report_paths(path)
    signed = load_json(record, SignedConformance)
    _require_signature(record, signed)
    if (path == page or page.exists()) and _digest(page) != signed.page_sha256:
        raise DatasetError(f"{page} was altered: it is not the page that {record.name} was signed with.")
    try:
        report = msgspec.convert(signed.report, ConformanceReport)
    except msgspec.ValidationError as fault:
        raise DatasetError(f"{record} is of another version of the program ({fault}): use that version.") from fault
    return VerifiedConformance(report, signed.signature.key)


def _require_signature(record: Path, signed: SignedConformance) -> None:
    """Raise DatasetError unless the signature fits."""
    content = _signed_bytes(signed.report, signed.page_sha256)
    if not is_signed(content, signed.signature.key, signed.signature.value):
        raise DatasetError(
            f"{record} was altered: its signature does not fit its contents. Ask the lab for the original."
        )


def _signed_bytes(report: dict[str, Any], page_sha256: str) -> bytes:
    """Return what is signed, independent of the layout of the file and of the order of its members."""
    return json.dumps({"page_sha256": page_sha256, "report": report}, sort_keys=True, separators=(",", ":")).encode()


def _digest(page: Path) -> str:
    try:
        return hashlib.sha256(page.read_bytes()).hexdigest()
    except OSError as fault:
        raise DatasetError(f"{page} cannot be read: {fault.strerror}.") from fault
