"""Signed report of the conformance of a rig: the page for people, and the file for programs."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

from wafer_viewer.model.acquisition.conformance import ConformanceReport, ConformanceResult, ConformanceSubject
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.quantity import Word
from wafer_viewer.model.report import Report, ReportSection, Table
from wafer_viewer.store.records.conformance_reports import (
    VerifiedConformance,
    report_html,
    verified_report,
    write_signed,
)
from wafer_viewer.store.records.signed_log import known_public_key, public_key, signing_key

HEADS = ("Check", "Verdict", "Measured", "Demand")
CELLS = {"passed": "PASS", "failed": "FAIL", "not run": "not run"}
PROOF = (
    "The signature shows that neither file was altered since somebody with this key signed them. It does not show who "
    "that was, nor that the rig was as the report says: compare the key with the one that the lab has published."
)


def write_conformance(report: ConformanceReport, path: Path, data_folder: Path) -> tuple[Path, Path]:
    """Write a signed report: NAME.json with all figures, and NAME.html for people.

    Parameters
    ----------
    report : ConformanceReport
        Results of the checks.
    path : Path
        NAME.html or NAME.json; both are written.
    data_folder : Path
        Data folder whose key signs the report; the key is made at the first report.

    Returns
    -------
    tuple of two paths
        The file with the figures and the page.

    Raises
    ------
    DatasetError
        When a file cannot be written, or the key cannot be read.
    """
    key = signing_key(data_folder)
    return write_signed(report, report_html(conformance_page(report, public_key(key))), path, key)


def verify_conformance(path: Path, key: str = "") -> VerifiedConformance:
    """Return a report if neither it nor its page was altered since it was signed.

    Parameters
    ----------
    path : Path
        One of the two files of a report. Both are verified where they lie side by side.
    key : str
        Public key of a lab, 64 hexadecimal digits: the report has to be signed with it. Any key if empty.

    Returns
    -------
    VerifiedConformance
        The report, and the key that it was signed with.

    Raises
    ------
    DatasetError
        When a file is missing, damaged, altered or signed with another key.
    """
    found = verified_report(path)
    if key and found.key != key.strip().lower():
        raise DatasetError(f"{path} was signed with the key {found.key}, not with {key}: it is of another lab.")
    return found


def own_key(data_folder: Path) -> str:
    """Return the public key of a data folder, hex; an empty text if it has signed no report."""
    return known_public_key(data_folder)


def conformance_page(report: ConformanceReport, key: str) -> Report:
    """Return the page of a report."""
    named = (("Rig", report.rig), ("Rig file", report.rig_file), ("By", report.by))
    return Report(
        title=f"Conformance of {report.rig}",
        below=f"{report.summary}; {report.at}",
        simulated=report.simulated,
        facts=(
            *((name, text) for name, text in named if text),
            ("Date", report.at),
            ("Program", f"Wafer Viewer {report.program_version}"),
        ),
        sections=(
            _verdict(report),
            ReportSection(
                "Devices",
                table=Table(
                    ("Role", "Driver", "Identity and firmware"),
                    tuple((device.role, device.driver, device.identity) for device in report.devices),
                    "ww",
                ),
            ),
            *(_checks(report, subject) for subject in get_args(ConformanceSubject)),
            ReportSection("Motion", sentences=tuple(map(_with_micro_sign, report.motions)), empty="Nothing was moved."),
            ReportSection("Settings of the rig", table=Table(("As in its file",), _lines(report.config))),
            ReportSection("Signature", pairs=(("Algorithm", "Ed25519"), ("Key", key)), sentences=(PROOF,)),
        ),
    )


def _verdict(report: ConformanceReport) -> ReportSection:
    word: Word = "fail" if report.counts["failed"] else "pass" if report.conforms else "inconclusive"
    reasons = tuple(f"{one.title}: {_with_micro_sign(one.why)}" for one in report.results if one.verdict != "passed")
    return ReportSection("Verdict", word=word, beside=f"{report.summary}.", sentences=reasons)


def _checks(report: ConformanceReport, subject: ConformanceSubject) -> ReportSection:
    rows = tuple(_row(result) for result in report.results if result.subject == subject)
    return ReportSection(subject.capitalize(), table=Table(HEADS, rows, "ww"))


def _row(result: ConformanceResult) -> tuple[str, ...]:
    figures = "; ".join(figure.text for figure in result.figures)
    measured = ". ".join(text for text in (result.why.rstrip("."), figures) if text)
    return (
        result.title,
        CELLS[result.verdict],
        _with_micro_sign(measured),
        f"{_with_micro_sign(result.demand)} ({result.name})",
    )


def _with_micro_sign(text: str) -> str:
    return text.replace(" um", "\u202fµm")


def _lines(config: str) -> tuple[tuple[str], ...]:
    return tuple((line,) for line in config.splitlines() if line.strip())
