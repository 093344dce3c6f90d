"""Licences of everything that the package and its tests install: `python tests/licences.py` prints the list."""

from __future__ import annotations

import importlib.metadata
import re
from collections.abc import Iterable
from functools import cache

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

PERMISSIVE = {
    *("0BSD", "Apache-2.0", "Apache-2.0 WITH LLVM-exception", "BSD-2-Clause", "BSD-3-Clause", "CC0-1.0", "ISC", "MIT"),
    *("MIT-0", "MIT-CMU", "PSF-2.0", "Zlib", "BSD", "Unlicense"),
}
WEAK_COPYLEFT = {"MPL-2.0"}
"""Asks for the sources of changed files of the library itself, which this package does not change."""
RUN_TIME = PERMISSIVE | WEAK_COPYLEFT
OF_NAMED = {
    "pymmcore": "LGPL-2.1-only",  # an extra, a library of its own that users may exchange
    "mm-test-adapters": "LGPL-2.1-only",  # of Micro-Manager like pymmcore; states none
    "genicam": "LicenseRef-GenICam-1.6",  # an extra, the reference implementation of EMVA
    "pylibczirw": "LGPL-3.0-only",  # an extra, a library of its own that users may exchange
    "igor2": "LGPL-3.0-or-later",  # brought along by the extra that reads surfaces of makers
    "docutils": "CC0-1.0",  # public domain but for some files that are not imported
}
"""Licences beyond `RUN_TIME`, or not stated in a form that can be read: of extras and tools of the tests alone."""
EXCHANGEABLE = {"libusb-package": "Apache-2.0 AND LGPL-2.1-or-later"}
"""Packages at run time with a shared library that users may exchange; they state only their own licence."""
_WORDS = {
    "mit license": "MIT",
    "mit": "MIT",
    "### mit license": "MIT",
    "the mit license (mit)": "MIT",
    "bsd license": "BSD",
    "bsd": "BSD",
    "bsd-3-clause": "BSD-3-Clause",
    "3-clause bsd": "BSD-3-Clause",
    "bsd 3-clause license": "BSD-3-Clause",
    "bsd 2-clause license": "BSD-2-Clause",
    "bsd-2-clause": "BSD-2-Clause",
    "apache software license": "Apache-2.0",
    "apache license": "Apache-2.0",
    "apache 2.0": "Apache-2.0",
    "apache 2": "Apache-2.0",
    "apache-2.0": "Apache-2.0",
    "isc license (iscl)": "ISC",
    "isc license": "ISC",
    "mozilla public license 2.0 (mpl 2.0)": "MPL-2.0",
    "mpl-2.0 and mit": "MPL-2.0 AND MIT",
    "mpl-2.0": "MPL-2.0",
    "python software foundation license": "PSF-2.0",
}


def stated(name: str) -> str:
    """Licence of an installed package as an SPDX expression; what it states where that is none."""
    if (known := (OF_NAMED | EXCHANGEABLE).get(canonicalize_name(name))) is not None:
        return known
    about = importlib.metadata.metadata(name)
    if expression := about.get("License-Expression"):
        return expression
    classes = [c.rpartition("::")[2].strip() for c in about.get_all("Classifier") or [] if c.startswith("License ::")]
    text = ((about.get("License") or "").strip().splitlines() or [""])[0]
    said = classes or [text]
    return " AND ".join(_WORDS.get(words.lower(), words or "none stated") for words in said)


def not_allowed(expression: str, allowed: Iterable[str]) -> list[str]:
    """Licences of an expression that are not allowed; one of several alternatives is enough."""
    alternatives = [re.split(r"\s+AND\s+", part.strip("() ")) for part in re.split(r"\s+OR\s+", expression)]
    wrong = [[one.strip("() ") for one in parts if one.strip("() ") not in allowed] for parts in alternatives]
    return min(wrong, key=len)


@cache
def installed(package: str = "wafer-viewer", extras: tuple[str, ...] = ()) -> frozenset[str]:
    """Names of all packages that a package needs here, with those extras."""
    found: set[tuple[str, str]] = set()
    to_see = [(package, extra) for extra in ("", *extras)]
    while to_see:
        name, extra = to_see.pop()
        if (canonicalize_name(name), extra) in found:
            continue
        found.add((canonicalize_name(name), extra))
        for text in importlib.metadata.requires(name) or []:
            needed = Requirement(text)
            if needed.marker is None or needed.marker.evaluate({"extra": extra}):
                to_see += [(needed.name, more) for more in ("", *needed.extras)]
    return frozenset(name for name, _ in found) - {canonicalize_name(package)}


if __name__ == "__main__":
    own = installed()
    for name in sorted(installed(extras=("dev",))):
        print(f"{name:28} {'run time' if name in own else 'tests':9} {stated(name)}")
