"""Command line: finds the command, parses its flags, and reports errors in one sentence with status 2."""

from __future__ import annotations

import difflib
import functools
import importlib
import sys
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

from wafer_viewer.model.errors import PlanError, WaferViewerError

PROGRAM = "wafer-viewer"
REFUSED, INTERRUPTED = 2, 130


class CommandEntry(NamedTuple):
    """Command: its module in this package, its summary, and its function if that has another name."""

    module: str
    summary: str
    function: str | None = None


COMMANDS: dict[str, CommandEntry] = {
    "serve": CommandEntry("acquisition", "open the viewer in the browser"),
    "plan": CommandEntry("acquisition", "estimate the time of every way to scan a plan; nothing moves"),
    "exposure": CommandEntry("acquisition", "find the exposure of a plan over its z range, or propose a bracket"),
    "focus": CommandEntry("acquisition", "go to the focus at a place, and print its z with U"),
    "scan": CommandEntry("acquisition", "scan without the browser, or continue an unfinished scan"),
    "inspect": CommandEntry("imports", "what files hold that may be imported, and what is doubtful"),
    "import": CommandEntry("imports", "make a dataset of images taken elsewhere, or of a surface file", "import_"),
    "batch": CommandEntry("imports", "one command on many files, with a table; goes on where it ended"),
    "reconstruct": CommandEntry("surface", "make a surface of a focus stack or a dataset, as a file"),
    "release": CommandEntry("acquisition", "make a plan a job that operators run with four actions"),
    "stitch": CommandEntry("surface", "make the stitched surface of a dataset"),
    "stitch-surfaces": CommandEntry("surface", "make one surface of several surface files that overlap"),
    "stitch-images": CommandEntry("surface", "make one picture of single images that overlap"),
    "measure dies": CommandEntry(
        "defects", "the lattice of the dies, and which are whole, cut, not scanned or missing"
    ),
    "measure gauge": CommandEntry(
        "calibration", "check the instrument against certified gauge blocks; history of checks"
    ),
    "measure capability": CommandEntry("calibration", "Cp and Cpk of a column of values against its limits"),
    "measure rr": CommandEntry("calibration", "repeatability and reproducibility of repeated measurements"),
    "measure defects": CommandEntry(
        "defects", "the defects of a patterned wafer, with a status by limits for each die"
    ),
    "measure difference": CommandEntry("measure", "the difference of two results kept, with its uncertainty"),
    "measure template": CommandEntry("templates", "the kept results of a dataset as a template for other surfaces"),
    "measure apply": CommandEntry("templates", "what a template measures, on many surfaces, in one table"),
    "measure verdict": CommandEntry("acquisition", "whether a wafer is good by the features of its job"),
    "calibrate delay": CommandEntry("calibration", "find the delay from the pulse to the exposure on the rig"),
    "calibrate pixel": CommandEntry("calibration", "find the pixel size and the camera's rotation on the rig"),
    "calibrate flat-field": CommandEntry("calibration", "measure shading and dark level of the image on a flat"),
    "calibrate noise": CommandEntry("calibration", "measure the noise of the heights by repeated scans of a field"),
    "calibrate flatness": CommandEntry("calibration", "measure the flatness deviation at several places of a flat"),
    "calibrate mapping": CommandEntry("calibration", "measure the distortion of the image against the stage"),
    "calibrate resolution": CommandEntry("calibration", "measure the width of the response to a step edge"),
    "calibrate z": CommandEntry("calibration", "set the z scale by a signed check against gauge blocks"),
    "calibrate linearity": CommandEntry("calibration", "amplification and linearity of z from signed checks"),
    "calibrate list": CommandEntry("calibration", "the calibrations with U, date and due day"),
    "lot": CommandEntry("defects", "Pareto, stack, yield, kill ratio and control chart of inspected wafers"),
    "adders": CommandEntry("defects", "defects added and removed between two inspections of a wafer"),
    "compare": CommandEntry("surface", "the second of two surfaces minus the first, aligned before"),
    "report": CommandEntry("surface", "write the report of a dataset as one HTML file that prints well"),
    "why": CommandEntry("surface", "why a pixel has its height, or none"),
    "paper": CommandEntry("validation", "repeat the paper's two jobs on the virtual rig, beside its tables"),
    "check": CommandEntry("acquisition", "test every checksum of a dataset and name missing frames"),
    "find": CommandEntry("upkeep", "find datasets by lot, wafer, product, verdict, date or name"),
    "log": CommandEntry("upkeep", "who scanned, released, changed, judged and signed what"),
    "tidy": CommandEntry("upkeep", "remove the frames of accepted datasets that are old enough; records stay"),
    "hold": CommandEntry("upkeep", "keep the frames of a dataset, however old they are"),
    "unhold": CommandEntry("upkeep", "end a hold"),
    "people add": CommandEntry("upkeep", "list a person who may sign in, as operator or engineer"),
    "people remove": CommandEntry("upkeep", "remove a person from the list"),
    "people list": CommandEntry("upkeep", "who may sign in, and in which role"),
    "compress": CommandEntry("acquisition", "make the frames of a dataset smaller without loss, or undo it"),
    "cluster": CommandEntry("acquisition", "make what several machines need to work together"),
    "convert": CommandEntry("surface", "write a surface in another format"),
    "fields": CommandEntry("surface", "write the fields of a stitched surface as images in place"),
    "docs": CommandEntry("upkeep", "open the documentation in the browser, offline"),
    "glossary": CommandEntry("upkeep", "what the words of this program mean"),
    "conformance": CommandEntry("acquisition", "check on the rig itself that it does what a scan needs; signed report"),
    "positioners": CommandEntry("acquisition", "light, objective, zoom, tilts and rotation of a rig; moves them"),
    "doctor": CommandEntry("upkeep", "what this machine has and lacks, and how to fix it"),
    "bundle": CommandEntry("upkeep", "write a support file without secrets"),
}
OWN_RECIPE = frozenset({"measure defects"})
"""Commands whose --recipe is not a reconstruction recipe; they parse it themselves."""


@functools.cache
def commands() -> dict[str, CommandEntry]:
    """Return all commands by name, with one for each measuring tool."""
    from wafer_viewer.model.measurement.tools import TOOLS

    tools = {f"measure {tool.name.replace('_', '-')}": CommandEntry("measure", tool.summary) for tool in TOOLS.values()}
    before = list(COMMANDS).index("measure dies")
    listed = list(COMMANDS.items())
    return dict((*listed[:before], *tools.items(), *listed[before:]))


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    try:
        return run(list(sys.argv[1:] if argv is None else argv)) or 0
    except KeyboardInterrupt:
        print(f"{PROGRAM}: stopped.", file=sys.stderr)
        return INTERRUPTED
    except WaferViewerError as fault:
        return _refuse(str(fault))
    except BrokenPipeError:
        sys.stderr.close()
        return REFUSED
    except OSError as fault:
        return _refuse(f"{fault.filename or PROGRAM}: {fault.strerror or fault}.")


def run(argv: list[str]) -> int | None:
    """Find the command and run it. Raises WaferViewerError for errors that the user can correct."""
    if not argv:
        argv = ["serve"]
    if argv[0] in ("-h", "--help", "help"):
        print(_overview())
        return None
    if argv[0] == "--version":
        from wafer_viewer._version import __version__

        print(f"{PROGRAM} {__version__}")
        return None
    group = [name for name in commands() if name.startswith(f"{argv[0]} ")]
    if group and argv[1:] in ([], ["-h"], ["--help"], ["help"]):
        print(_group_overview(argv[0], group))
        return None
    name, rest = _command(argv)
    return _call(name, rest)


def _command(argv: list[str]) -> tuple[str, list[str]]:
    """Return the command's name and its arguments; flags alone belong to `serve`."""
    if argv[0].startswith("-"):
        return "serve", argv
    for words in (2, 1):
        if (name := " ".join(argv[:words])) in commands():
            return name, argv[words:]
    if argv[0] == "measure":
        _refuse_two_sided(argv[1:2])
    first, *others = argv[:2]
    known = dict.fromkeys(name.split()[0] for name in commands())
    within = [name.removeprefix(f"{first} ") for name in commands() if name.startswith(f"{first} ")]
    group = f"{first} " if within and others else ""
    asked = others[0] if group else first
    near = difflib.get_close_matches(asked, within if group else known, n=1)
    mend = f"did you mean '{group}{near[0]}'?" if near else f"'{PROGRAM} {group or '--'}help' lists them."
    raise PlanError(f"There is no command '{group}{asked}': {mend}")


def _refuse_two_sided(terms: list[str]) -> None:
    """Raise MeasureError for a term that a map of one side cannot have."""
    from wafer_viewer.measure.tools.site_range import REFUSED, refuse

    for term in terms:
        if term.lower() in REFUSED:
            raise refuse(term.lower())


def _call(name: str, rest: list[str]) -> int | None:
    """Parse the flags of a command by its signature, and call it."""
    import tyro

    from wafer_viewer.cli.parser import for_people, recipe_file

    function = _function(name)
    if name == "batch":
        rest, words = _split_at_dashes(rest)
        function = functools.partial(function, words=words, run=run)
    recipe, rest = (None, rest) if name in OWN_RECIPE else recipe_file(rest)
    if recipe is not None:
        function = functools.partial(function, recipe=recipe)
    prog = f"{PROGRAM} {name}"
    with for_people(rest, prog):
        return tyro.cli(function, prog=prog, args=rest, config=(tyro.conf.FlagCreatePairsOff,))


def _split_at_dashes(rest: list[str]) -> tuple[list[str], tuple[str, ...]]:
    """Return the arguments before and after ``--``."""
    at = rest.index("--") if "--" in rest else len(rest)
    return rest[:at], tuple(rest[at + 1 :])


def _function(name: str) -> Callable[..., int | None]:
    """Return the function of a command; one is made of its descriptor for a measuring tool that has none."""
    command = commands()[name]
    module = importlib.import_module(f"wafer_viewer.cli.{command.module}")
    named = command.function or name.replace(" ", "_").replace("-", "_")
    if (function := getattr(module, named, None)) is not None:
        return function
    from wafer_viewer.model.measurement.tools import TOOLS

    return module.tool_command(TOOLS[named.removeprefix("measure_")])


def _group_overview(first: str, names: list[str]) -> str:
    """Return the commands of a group with what each answers; measuring tools by family."""
    from wafer_viewer.model.measurement.tools import TOOLS

    families: dict[str, list[str]] = {}
    for name in names:
        tool = TOOLS.get(name.removeprefix("measure ").replace("-", "_"))
        family = tool.group if first == "measure" and tool is not None else ""
        families.setdefault(family or (_NOT_ONE_SURFACE if first == "measure" else ""), []).append(name)
    blocks = ["\n".join(filter(None, (family, *_summaries(members)))) for family, members in families.items()]
    return "\n\n".join((f"usage: {PROGRAM} {first} COMMAND [OPTIONS]", *blocks, f"Flags: {PROGRAM} {names[0]} --help"))


_NOT_ONE_SURFACE = "Dies, gauge blocks and verdicts"


def _summaries(names: Iterable[str]) -> list[str]:
    width = max(map(len, commands()))
    return [f"  {name:<{width}}  {commands()[name].summary}" for name in names]


def _overview() -> str:
    lines = _summaries(commands())
    return "\n".join(
        [
            f"usage: {PROGRAM} [COMMAND] [OPTIONS]",
            "",
            "Takes focus stacks of wafers, makes surfaces of them, shows and measures them.",
            "Without a command it opens the viewer on the virtual rig.",
            "",
            *lines,
            "",
            f"{PROGRAM} COMMAND --help says more about one of them.",
        ]
    )


def _refuse(sentence: str) -> int:
    print(f"{PROGRAM}: {' '.join(sentence.split())}", file=sys.stderr)
    return REFUSED
