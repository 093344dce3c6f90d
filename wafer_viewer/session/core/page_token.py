"""Token of the page's address, stored with the data folder so that an open page reconnects after a restart.

The token is in a separate file, ``.wafer-viewer/token``, readable by its owner only. Two programs on one folder share
the token; their cookies differ by port. A stored token is used only if nobody else can have read or placed the file.
"""

from __future__ import annotations

import logging
import os
import re
import secrets
from pathlib import Path

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.session.core.private_file import create_private, read_private, replace_private
from wafer_viewer.session.session_restore import KEPT_IN

NAME = "token"
_BYTES = 24
_IS_TOKEN = re.compile(r"[A-Za-z0-9_-]{32,128}")
_MEND = (
    "the page would be open to others. Start once with --new-token, or delete the file; addresses printed earlier no "
    "longer open the page."
)
log = logging.getLogger(__name__)


def new_token() -> str:
    """Return a token that nobody can guess, for URLs and cookies."""
    return secrets.token_urlsafe(_BYTES)


def page_token(folder: Path, *, renew: bool = False) -> str:
    """Return the token of a data folder, made at the first start.

    Parameters
    ----------
    folder
        The data folder.
    renew
        Replace the token, so that addresses printed earlier no longer open the page.

    Returns
    -------
    str
        The token; one for this run alone where the folder cannot be written to.

    Raises
    ------
    DatasetError
        Others may have read or placed the file, or it holds no token.
    """
    path = folder / KEPT_IN / NAME
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if renew:
            replace_private(path, f"{new_token()}\n")
        elif not os.path.lexists(path):
            create_private(path, f"{new_token()}\n")
    except OSError as fault:
        if renew:
            raise DatasetError(f"{path} cannot be replaced ({fault.strerror}): the token stays as it was.") from fault
        if not os.path.lexists(path):
            log.warning("The token holds for this run only, %s cannot be written: %s", path, fault.strerror)
            return new_token()
    text = read_private(path, _MEND)
    if not _IS_TOKEN.fullmatch(text):
        raise DatasetError(f"{path} holds no token: {_MEND}")
    return text
