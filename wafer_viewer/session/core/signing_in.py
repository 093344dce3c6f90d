"""Author of a command without a browser: the account, or a listed person by name and password."""

from __future__ import annotations

import getpass
import os
import sys
from pathlib import Path

from wafer_viewer.model.audit import Action
from wafer_viewer.model.errors import PlanError, RoleError
from wafer_viewer.model.roles import Person, Role, refusal, role_for
from wafer_viewer.session.core.audit_trail import account
from wafer_viewer.session.core.people import engineers_of, listed_people, signed_in

PASSWORD_VARIABLE, NEW_PASSWORD_VARIABLE = "WAFER_VIEWER_PERSON_PASSWORD", "WAFER_VIEWER_NEW_PASSWORD"
"""Variables that scripts give passwords in; they are removed from the environment of processes started later."""


def acting_person(folder: Path, action: Action, by: str | None, flag: str = "--by") -> Person | None:
    """Return who may do an action in a data folder; None where nobody is listed and everyone is an engineer.

    by: the name that was given with `flag`; the password is asked for, or taken from `PASSWORD_VARIABLE`. Raises
    PlanError without a name, WaferViewerError for a wrong password, RoleError if the role does not allow it.
    """
    people = listed_people(folder)
    if not people:
        return None
    if not by:
        who = "an engineer" if role_for(action) == "engineer" else "somebody who is listed"
        raise PlanError(f"People are listed in {folder}: name {who} with {flag} NAME.")
    person = signed_in(folder, by, _password(by, flag))
    if (why := refusal(action, person.name, person.role, engineers_of(people))) is not None:
        raise RoleError(why)
    return person


def require_reason(person: Person | None, why: str, flag: str = "--reason") -> None:
    """Raise PlanError if a listed person gives no reason."""
    if person is not None and not why.strip():
        raise PlanError(f"This needs a reason: say why with {flag} TEXT.")


def name_of(person: Person | None, by: str | None) -> str:
    """Return the name for the audit log: that of the person, else the one given, else the account."""
    return person.name if person is not None else by or account()


def role_of(person: Person | None) -> Role:
    """Return the role of who acts."""
    return "engineer" if person is None else person.role


def _password(name: str, flag: str) -> str:
    if (given := os.environ.pop(PASSWORD_VARIABLE, None)) is not None:
        return given
    if not sys.stdin.isatty():
        raise PlanError(
            f"{flag} {name} needs the password of {name}: there is no terminal to type it, so give it in "
            f"{PASSWORD_VARIABLE}."
        )
    return getpass.getpass(f"Password of {name}: ")


def new_password(name: str) -> str:
    """Return a new password, typed twice, or taken from `NEW_PASSWORD_VARIABLE`.

    Raises PlanError if the two differ, or if there is no terminal.
    """
    if (given := os.environ.pop(NEW_PASSWORD_VARIABLE, None)) is not None:
        return given
    if not sys.stdin.isatty():
        raise PlanError(f"There is no terminal to type the password of {name}: give it in {NEW_PASSWORD_VARIABLE}.")
    first = getpass.getpass(f"New password of {name}: ")
    if first != getpass.getpass("Once more: "):
        raise PlanError("The two passwords differ: nothing was changed.")
    return first
