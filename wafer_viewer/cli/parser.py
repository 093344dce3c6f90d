"""Adapter of the flag parser: help without frames, and errors as one sentence."""

from __future__ import annotations

import contextlib
import io
import re
from collections.abc import Generator, Sequence
from pathlib import Path
from typing import NoReturn

from tyro import _errors as parse_errors

from wafer_viewer.model.errors import PlanError
from wafer_viewer.model.spec import decode, settings_of
from wafer_viewer.model.surface.recipe import READY_RECIPES, Recipe

_NAMES = ", ".join(READY_RECIPES)
_SAYS_NOTHING = re.compile(r"\s*\(default:\s+(None|False|)\)")


def recipe_file(argv: list[str]) -> tuple[Recipe | None, list[str]]:
    """Take ``--recipe FILE.toml`` or ``--recipe NAME`` out of the arguments; settings, ``--recipe.window 9``, stay."""
    for i, word in enumerate(argv):
        if word == "--recipe":
            if i + 1 == len(argv):
                raise PlanError(f"--recipe needs a file or a name: give a RECIPE.toml or one of {_NAMES}.")
            return read_recipe(argv[i + 1]), argv[:i] + argv[i + 2 :]
        if word.startswith("--recipe="):
            return read_recipe(word.removeprefix("--recipe=")), argv[:i] + argv[i + 1 :]
    return None, argv


def read_recipe(name: str) -> Recipe:
    """Return a ready recipe by its name, or that of a TOML file. Raises PlanError when there is none."""
    from wafer_viewer.store.io.guarded_reading import read_content

    if name in READY_RECIPES:
        return READY_RECIPES[name]
    path = Path(name)
    if not path.is_file():
        raise PlanError(f"{path} cannot be read, it does not exist: check the path, or take a ready one: {_NAMES}.")
    return decode(read_content(path, PlanError), Recipe, path.name)


@contextlib.contextmanager
def for_people(argv: Sequence[str], prog: str) -> Generator[None]:
    """Print plain help and raise PlanError for invalid flags while a command's flags are parsed."""
    with _plain_help(argv), parse_errors.on_parse_error(lambda event: _refuse(event, prog)):
        yield


@contextlib.contextmanager
def _plain_help(argv: Sequence[str]) -> Generator[None]:
    if not {"-h", "--help"} & set(argv):
        yield
        return
    framed = io.StringIO()  # has no encoding, so that the rules come out as hyphens
    try:
        with contextlib.redirect_stdout(framed):
            yield
    finally:
        print(unframed(framed.getvalue()))


def unframed(text: str) -> str:
    """Return help text with plain headings instead of rules, and without empty defaults."""
    lines: list[str] = []
    for line in (framed.rstrip() for framed in _SAYS_NOTHING.sub("", text).splitlines()):
        if line and not line.strip(" -"):
            if lines[-1][:2].strip():  # a title stands one column in, an explanation two
                lines[-1] = f"{lines[-1].strip()}:"
        elif line or (lines and lines[-1]):
            lines += [line, *_meaning(line)]
    return "\n".join(lines).rstrip()


def _meaning(line: str) -> list[str]:
    """Return the line that explains the flag of a setting of a recipe, from the setting's own label."""
    flag = re.match(r" *--recipe\.(?:no-)?([\w.-]+)", line)
    field = settings_of(Recipe).get(flag[1].replace("-", "_")) if flag else None
    if field is None:
        return []
    unit = f", {field.setting.unit}" if field.setting.unit else ""
    return [f"        {field.setting.title}{unit}. {field.hint}."]


def _refuse(event: parse_errors.ParseErrorEvent, prog: str) -> NoReturn:
    raise PlanError(f"{_what(event)}; {prog} --help says what there is.")


def _what(event: parse_errors.ParseErrorEvent) -> str:
    match event:
        case parse_errors.MissingArgs():
            names = [arg.arg.display_name() for arg in event.missing_arguments]
            unknown = f"; {_unknown(event.unrecognized_tokens)}" if event.unrecognized_tokens else ""
            return f"Missing: {', '.join(names)}{unknown}"
        case parse_errors.UnrecognizedArgs():
            return _unknown(event.tokens)
        case parse_errors.InvalidChoice():
            return f"{event.argument.display_name()} is {event.value!r}: it must be one of {', '.join(event.choices)}"
        case parse_errors.BadValue():
            return f"{event.argument.display_name()} lacks a value"
        case parse_errors.InstantiationFailure(argument=argument) if argument is not None:
            return f"{argument.display_name()} cannot be that: {_first_reason(event.message)}"
        case parse_errors.InstantiationFailure():
            return _first_reason(event.message)
        case _:
            return "The command cannot be read"


def _unknown(tokens: Sequence[str]) -> str:
    return f"Not known here: {' '.join(tokens)}"


def _first_reason(message: str) -> str:
    """Return the reason of a failed conversion: the words that are not numbers of the required kind."""
    words = re.search(r"arguments \[(.*?)\]|from \[(.*?)\]|: '(.*?)'", message)
    given = next((g for g in words.groups() if g is not None), "") if words else ""
    kind = "whole number" if "int()" in message else "number"
    return f"{given.replace(',', '')} is no {kind}" if given else message.splitlines()[0]
