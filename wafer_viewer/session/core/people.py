"""People who may sign in at a station, with their roles: ``.wafer-viewer/people`` of the data folder.

The file holds hashes of passwords, and is for its owner only. Without it everyone at the station is an engineer.
"""

from __future__ import annotations

import getpass
import os
import sys
from pathlib import Path
from typing import ClassVar

from wafer_viewer.model.errors import DatasetError, PlanError, RoleError, WaferViewerError
from wafer_viewer.model.roles import Action, Person, Role, refusal, role_for
from wafer_viewer.model.spec import Spec, decode, encode
from wafer_viewer.session.core.audit_trail import account
from wafer_viewer.session.core.private_file import PasswordHash, read_private, replace_private
from wafer_viewer.session.session_restore import KEPT_IN

# --------------------------------------------------------------------------------------------------------------- people


NAME = "people"
LONGEST_NAME = 40
NOT_RIGHT = "The name or the password is wrong."
_MEND = "remove it, and add the people again with wafer-viewer people add."


class _People(Spec, frozen=True, kw_only=True):
    """The file of people."""

    error: ClassVar[type[WaferViewerError]] = DatasetError
    people: tuple[Person, ...] = ()


def listed_people(folder: Path) -> tuple[Person, ...]:
    """Return the people of a data folder, in the order in which they were added; nobody without a file.

    Raises DatasetError if others may have read or placed the file, or if it cannot be read as a list of people.
    """
    path = folder / KEPT_IN / NAME
    if not (path.exists() or path.is_symlink()):
        return ()
    found = decode(read_private(path, _MEND).encode(), _People, path.name, "json").people
    if not any(person.role == "engineer" for person in found):
        raise DatasetError(f"{path} lists no engineer: {_MEND}")
    return found


def engineers_of(people: tuple[Person, ...]) -> tuple[str, ...]:
    """Return the names of the engineers."""
    return tuple(person.name for person in people if person.role == "engineer")


def add_person(folder: Path, name: str, role: Role, password: str) -> Person:
    """Add a person, or give one another role and password.

    Raises PlanError for a bad name or password, and where no engineer would be listed; DatasetError if the file cannot
    be written.
    """
    name = tidy_name(name)
    if not name or not name.isprintable():
        raise PlanError("The person has no name: give one that can be printed.")
    person = Person(name=name, role=role, password=PasswordHash.of(password).text)
    others = tuple(other for other in listed_people(folder) if other.name.casefold() != name.casefold())
    _write(folder, (*others, person))
    return person


def remove_person(folder: Path, name: str) -> None:
    """Remove a person; with the last one the list ends, and everyone is an engineer again.

    Raises PlanError if there is none of that name, or if operators would be left without an engineer.
    """
    people = listed_people(folder)
    others = tuple(person for person in people if person.name.casefold() != tidy_name(name).casefold())
    if len(others) == len(people):
        raise PlanError(f"Nobody is listed as '{name}': {_names(people)}.")
    if others:
        _write(folder, others)
    else:
        (folder / KEPT_IN / NAME).unlink()


def signed_in(folder: Path, name: str, password: str) -> Person:
    """Return the person with a name and password; a wrong name takes as long as a wrong password.

    Raises WaferViewerError if one of them is not right.
    """
    people = listed_people(folder)
    person = next((person for person in people if person.name.casefold() == tidy_name(name).casefold()), None)
    stored = PasswordHash.read((person or people[0]).password) if people else None
    if stored is None:
        raise DatasetError(f"{folder / KEPT_IN / NAME} lists nobody who could sign in.")
    if not stored.matches(password) or person is None:
        raise WaferViewerError(NOT_RIGHT)
    return person


def tidy_name(name: str) -> str:
    """Return a name without superfluous space, at most `LONGEST_NAME` letters."""
    return " ".join(name.split())[:LONGEST_NAME]


def _write(folder: Path, people: tuple[Person, ...]) -> None:
    if not engineers_of(people):
        raise PlanError(f"Somebody must be an engineer, or nobody could release a job: {_names(people)}.")
    path = folder / KEPT_IN / NAME
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_private(path, _ascii(encode(_People(people=people), "json")))
    except OSError as fault:
        raise DatasetError(f"{path} cannot be written ({fault.strerror}).") from fault


def _ascii(text: str) -> str:
    """Return JSON with escapes for all letters that are not ASCII."""
    import json

    return json.dumps(json.loads(text), indent=1)


def _names(people: tuple[Person, ...]) -> str:
    return ", ".join(f"{person.name} ({person.role})" for person in people) or "nobody is listed"


# ----------------------------------------------------------------------------------------------------------- signing in


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
