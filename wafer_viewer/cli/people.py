"""Commands for the people of a station: who may sign in, and in which role.

The signature of a command defines its flags, its docstring is its help.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from wafer_viewer.cli.arguments import DATA_FOLDER, Text
from wafer_viewer.cli.output import audit, print_lines
from wafer_viewer.model.roles import Role

PersonName = Annotated[Positional[str], arg(metavar="NAME")]


def people_add(name: PersonName, role: Role, data: Path = DATA_FOLDER, by: Text = None, reason: str = "") -> None:
    """List a person who may sign in, or give one another role and password; the password is typed twice.

    Without anybody listed, everyone at the station is an engineer. The first person must be one.

    Args:
        name: Name of the person, as it stands in the audit log.
        role: operator runs released jobs; engineer may do everything.
        data: Folder of the datasets.
        by: Engineer who lists the person, once somebody is listed.
        reason: Reason, for the audit log; needed once somebody is listed.
    """
    from wafer_viewer.session.core.people import add_person
    from wafer_viewer.session.core.signing_in import acting_person, name_of, new_password, require_reason

    folder = data.expanduser()
    actor = acting_person(folder, "Person added", by)
    require_reason(actor, reason)
    person = add_person(folder, name, role, new_password(name))
    audit(folder, "Person added", person.name, _detail(role, reason), by=name_of(actor, by))
    print(f"{person.name} may sign in as {role}.")


def people_remove(name: PersonName, data: Path = DATA_FOLDER, by: Text = None, reason: str = "") -> None:
    """Remove a person; when the last one has gone, everyone at the station is an engineer again.

    Args:
        name: Name of the person.
        data: Folder of the datasets.
        by: Engineer who removes the person.
        reason: Reason, for the audit log.
    """
    from wafer_viewer.session.core.people import remove_person
    from wafer_viewer.session.core.signing_in import acting_person, name_of, require_reason

    folder = data.expanduser()
    actor = acting_person(folder, "Person removed", by)
    require_reason(actor, reason)
    remove_person(folder, name)
    audit(folder, "Person removed", name, _detail("", reason), by=name_of(actor, by))
    print(f"{name} may no longer sign in.")


def people_list(data: Path = DATA_FOLDER) -> int:
    """List who may sign in; status 1 when nobody is listed, and everyone at the station is an engineer.

    Args:
        data: Folder of the datasets.
    """
    from wafer_viewer.session.core.people import listed_people

    people = listed_people(data.expanduser())
    print_lines(f"{person.name}: {person.role}" for person in people)
    if not people:
        print("Nobody is listed: everyone at the station is an engineer.")
    return 0 if people else 1


def _detail(role: str, reason: str) -> str:
    return ", ".join(f"{name}: {value}" for name, value in (("role", role), ("why", " ".join(reason.split()))) if value)
