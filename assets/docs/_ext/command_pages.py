"""Directive ``{command-help}``: every command of the program with the help that its parser prints."""

from __future__ import annotations

import contextlib
import io
from itertools import takewhile

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from wafer_viewer.cli.app import PROGRAM, commands, main


def help_of(name: str) -> list[str]:
    """Return the paragraphs of a command's help as the program prints it."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.suppress(SystemExit):
        main([*name.split(), "--help"])
    return printed.getvalue().strip().split("\n\n")


class CommandHelp(SphinxDirective):
    """Sections of all commands, in the order of the overview."""

    def run(self) -> list[nodes.Node]:
        """Return one section a command."""
        return [self._section(name) for name in commands()]

    def _section(self, name: str) -> nodes.section:
        usage, *rest = help_of(name)
        sentences = list(takewhile(lambda part: not part.splitlines()[0].endswith(":"), rest))
        section = nodes.section(ids=[f"command-{name.replace(' ', '-')}"])
        section += nodes.title("", "", nodes.literal(text=f"{PROGRAM} {name}"))
        section += nodes.literal_block(text=usage, language="text")
        section += [nodes.paragraph(text=" ".join(part.split())) for part in sentences]
        section += nodes.literal_block(text="\n\n".join(rest[len(sentences) :]), language="text")
        return section


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("command-help", CommandHelp)
    return {"parallel_read_safe": True}
