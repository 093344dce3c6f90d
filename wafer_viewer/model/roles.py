"""People at a station: their roles, and the entries of the audit log that tell what they did.

Where nobody is listed, everyone at the station is an engineer.
"""

from __future__ import annotations

from typing import ClassVar, Literal

from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.model.spec import Spec

# ---------------------------------------------------------------------------------------------------------------- audit


Through = Literal["page", "command line", "Python"]
Action = Literal[
    "Scan started",
    "Scan continued",
    "Scan stopped",
    "Scan made",
    "Surface made",
    "Surfaces compared",
    "Surface imported",
    "Images imported",
    "Images stitched",
    "Plan saved",
    "Job released",
    "Gauge check signed",
    "Scale of z corrected",
    "Calibration accepted",
    "Result kept",
    "Result deleted",
    "Change of results undone",
    "Change of results redone",
    "Finding judged",
    "Judgement of findings undone",
    "Judgement of findings redone",
    "Defects judged",
    "Defect limits changed",
    "Class table changed",
    "Change of defects undone",
    "Change of defects redone",
    "Defect recipe saved",
    "Defect recipe deleted",
    "Golden die kept",
    "Frames held",
    "Hold ended",
    "Frames removed",
    "Person added",
    "Person removed",
]
"""Everything that the audit log holds; an action is entered here and with the command that carries it out."""


class AuditEntry(Spec, frozen=True, kw_only=True):
    """One action that changed something.

    at: UTC, ISO 8601; by: name of the browser, or of the account; through: where it was done; action: what was done;
    subject: dataset, job or file that it was done to; detail: what was given with it; sha256: digest, hex, of the file
    that it wrote.
    """

    error: ClassVar[type[WaferViewerError]] = DatasetError
    at: str
    by: str
    through: Through
    action: str
    subject: str = ""
    detail: str = ""
    sha256: str = ""


# ---------------------------------------------------------------------------------------------------------------- roles


Role = Literal["operator", "engineer"]
NEED_ENGINEER: dict[Action, str] = {
    "Plan saved": "changes plans and jobs",
    "Job released": "releases jobs",
    "Scale of z corrected": "changes calibrations",
    "Calibration accepted": "changes calibrations",
    "Finding judged": "changes verdicts",
    "Judgement of findings undone": "changes verdicts",
    "Judgement of findings redone": "changes verdicts",
    "Defects judged": "changes verdicts",
    "Defect limits changed": "changes verdicts",
    "Class table changed": "changes verdicts",
    "Change of defects undone": "changes verdicts",
    "Change of defects redone": "changes verdicts",
    "Defect recipe saved": "changes recipes",
    "Defect recipe deleted": "changes recipes",
    "Golden die kept": "changes recipes",
    "Hold ended": "ends a hold",
    "Frames removed": "removes frames",
    "Person added": "changes the list of people",
    "Person removed": "changes the list of people",
}
"""Actions of engineers only, each with what it is, as a refusal names it; all others are for operators as well."""


class Person(Spec, frozen=True, kw_only=True):
    """Person who may sign in. password: its salted hash."""

    error: ClassVar[type[WaferViewerError]] = DatasetError
    name: str
    role: Role
    password: str


def role_for(action: Action | None) -> Role:
    """Return the role that an action needs."""
    return "engineer" if action in NEED_ENGINEER else "operator"


def may(role: Role, needed: Role) -> bool:
    """Return whether somebody in a role may do what needs a role; engineers may do everything."""
    return role == "engineer" or needed == "operator"


def refusal(action: Action, name: str, role: Role, engineers: tuple[str, ...]) -> str | None:
    """Return why somebody may not do an action, with the rule and who may; None if allowed."""
    if may(role, role_for(action)):
        return None
    return f"{rule(NEED_ENGINEER[action], engineers)} {name} is signed in as {role}."


def rule(what: str, engineers: tuple[str, ...]) -> str:
    """Return the rule that only engineers do something, with their names."""
    return f"Only an engineer {what}: {' or '.join(engineers)}."
