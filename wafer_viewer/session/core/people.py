"""People who may sign in at a station, with their roles: ``.wafer-viewer/people`` of the data folder.

The file holds hashes of passwords, and is for its owner only. Without it everyone at the station is an engineer.
"""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from wafer_viewer.model.errors import DatasetError, PlanError, WaferViewerError
from wafer_viewer.model.roles import Person, Role
from wafer_viewer.model.spec import Spec, decode, encode
from wafer_viewer.session.core.page_password import PasswordHash
from wafer_viewer.session.core.private_file import read_private, replace_private
from wafer_viewer.session.session_restore import KEPT_IN

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
