"""Count what the project weighs: lines of code by room, imports, files, and the size of the installation.

Lines of code are lines that hold a token of the program: no blanks, comments or docstrings. Imports are a share of all
lines.

    python tests/weight.py               what lies in the checkout
    python tests/weight.py --installed   also the sizes of the packages in this environment
"""

from __future__ import annotations

import ast
import io
import sys
import tokenize
from collections import defaultdict
from importlib import metadata
from pathlib import Path

ROOT = Path(__file__).parents[1]
NO_CODE = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER)


def code_lines(text: str) -> set[int]:
    """Return the numbers of the lines that hold code."""
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    held = {n for t in tokens if t.type not in NO_CODE for n in range(t.start[0], t.end[0] + 1)}
    return held - lines_of(node for node in ast.walk(ast.parse(text)) if is_text(node))


def is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def lines_of(nodes) -> set[int]:
    return {n for node in nodes for n in range(node.lineno, node.end_lineno + 1)}


def weigh(folder: Path) -> dict[str, tuple[int, ...]]:
    """Return files, lines of code, lines of imports and all lines of each room of a folder."""
    rooms: dict[str, list[int]] = defaultdict(lambda: [0, 0, 0, 0])
    for file in sorted(folder.rglob("*.py")):
        text, within = file.read_text(), file.relative_to(folder).parts
        imports = (node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Import | ast.ImportFrom))
        room = rooms[within[0] if len(within) > 1 else "(top)"]
        for k, n in enumerate((1, len(code_lines(text)), len(lines_of(imports)), len(text.splitlines()))):
            room[k] += n
    return {name: tuple(counts) for name, counts in rooms.items()}


def show(folder: Path) -> None:
    rooms = weigh(folder)
    rooms["in all"] = tuple(map(sum, zip(*rooms.values(), strict=True)))
    print(f"\n{folder.name:<24}{'files':>8}{'code lines':>12}{'imports':>10}")
    for name, (files, code, imports, lines) in sorted(rooms.items(), key=lambda row: row[1][1]):
        print(f"{name:<24}{files:>8}{code:>12,}{imports / lines:>10.1%}")


def show_installed() -> None:
    sizes = {
        one.name: sum(Path(path).stat().st_size for f in one.files or () if (path := one.locate_file(f)).exists())
        for one in metadata.distributions()
    }
    print(f"\n{'installed':<24}{'MB':>8}")
    for name, size in sorted(sizes.items(), key=lambda row: row[1])[-15:]:
        print(f"{name:<24}{size / 1e6:>8.0f}")
    print(f"{f'all {len(sizes)} packages':<24}{sum(sizes.values()) / 1e6:>8.0f}")


if __name__ == "__main__":
    show(ROOT / "wafer_viewer")
    show(ROOT / "tests")
    if "--installed" in sys.argv:
        show_installed()
