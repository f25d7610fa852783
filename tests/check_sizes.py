"""Style that linters do not measure: sizes of functions and files, annotations, forbidden shortcuts.

Usage: python tests/check_sizes.py [ROOT]    (exit 1 and a list of offenders when the bar is missed)
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median, quantiles

PACKAGES = ("onboard", "drivers", "simulation", "ground_station", "models", "benchmarks")
FUNCTION_MEDIAN, FUNCTION_P90, FUNCTION_MAX = 8, 30, 60
FILE_MEDIAN, FILE_MAX = 120, 300
KERNEL_DECORATORS = {"njit", "jit", "vectorize", "guvectorize"}
FORBIDDEN_WORDS = re.compile(r"\b(TODO|FIXME|XXX|NotImplementedError)\b")
Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass
class Survey:
    """Everything that the walk over the sources found."""

    functions: list[int] = field(default_factory=list)
    kernels: list[int] = field(default_factory=list)
    files: list[int] = field(default_factory=list)
    offenders: list[str] = field(default_factory=list)


def function_lines(function: Function) -> int:
    """Lines from `def` to the end, docstring not counted."""
    lines = (function.end_lineno or function.lineno) - function.lineno + 1
    first = function.body[0]
    if ast.get_docstring(function, clean=False) is None:
        return lines
    return lines - ((first.end_lineno or first.lineno) - first.lineno + 1)


def is_kernel(function: Function) -> bool:
    """Whether a decorator compiles the function (numba)."""
    targets = [d.func if isinstance(d, ast.Call) else d for d in function.decorator_list]
    names = {t.attr if isinstance(t, ast.Attribute) else getattr(t, "id", "") for t in targets}
    return bool(names & KERNEL_DECORATORS)


def missing_annotations(function: Function) -> list[str]:
    """Names of the arguments without annotation, and 'return'."""
    arguments = function.args
    positional = [*arguments.posonlyargs, *arguments.args]
    extra = [a for a in (arguments.vararg, arguments.kwarg) if a is not None]
    bare = [a.arg for a in [*positional, *arguments.kwonlyargs, *extra] if a.annotation is None]
    if positional and bare and bare[0] == positional[0].arg and bare[0] in ("self", "cls"):
        bare = bare[1:]
    return bare + (["return"] if function.returns is None else [])


def handler_problem(handler: ast.ExceptHandler) -> str | None:
    """What is wrong with an except clause, if anything."""
    if handler.type is None:
        return "bare except"
    if all(isinstance(s, ast.Pass) or _is_ellipsis(s) for s in handler.body):
        return "except clause that swallows the error"
    return None


def _is_ellipsis(statement: ast.stmt) -> bool:
    return (
        isinstance(statement, ast.Expr)
        and isinstance(statement.value, ast.Constant)
        and statement.value.value is Ellipsis
    )


def survey_function(survey: Survey, place: str, function: Function) -> None:
    """Count one function and note what is wrong with it."""
    lines = function_lines(function)
    kernel = is_kernel(function)
    (survey.kernels if kernel else survey.functions).append(lines)
    if lines > FUNCTION_MAX and not kernel:
        survey.offenders.append(f"{place}: {function.name} has {lines} lines (max {FUNCTION_MAX})")
    if missing := missing_annotations(function):
        survey.offenders.append(f"{place}: {function.name} lacks annotations: {', '.join(missing)}")


def survey_file(survey: Survey, path: Path, name: str) -> None:
    """Count one file and note what is wrong in it."""
    text = path.read_text(encoding="utf-8")
    lines = text.splitlines()
    if lines:
        survey.files.append(len(lines))
    if len(lines) > FILE_MAX:
        survey.offenders.append(f"{name}: {len(lines)} lines (max {FILE_MAX})")
    for number, line in enumerate(lines, start=1):
        if found := FORBIDDEN_WORDS.search(line):
            survey.offenders.append(f"{name}:{number}: {found.group()}")
    for node in ast.walk(ast.parse(text, filename=name)):
        if isinstance(node, Function):
            survey_function(survey, f"{name}:{node.lineno}", node)
        elif isinstance(node, ast.ExceptHandler) and (problem := handler_problem(node)):
            survey.offenders.append(f"{name}:{node.lineno}: {problem}")


def sources(root: Path) -> Iterator[Path]:
    """Every Python file of the packages under `root`."""
    for package in PACKAGES:
        yield from sorted((root / package).rglob("*.py"))


def p90(values: list[int]) -> float:
    return quantiles(values, n=10, method="inclusive")[-1] if len(values) > 1 else float(sum(values))


def summarise(survey: Survey) -> list[str]:
    """The statistics as lines of text; a missed bar is added to the offenders."""
    texts = []
    bars = (
        ("functions", survey.functions, FUNCTION_MEDIAN, FUNCTION_P90),
        ("kernels", survey.kernels, None, None),
        ("files", survey.files, FILE_MEDIAN, None),
    )
    for name, values, median_bar, p90_bar in bars:
        middle, tail = (median(values), p90(values)) if values else (0.0, 0.0)
        texts.append(
            f"{name:9} {len(values):5}  median {middle:g}  p90 {tail:g}  max {max(values, default=0)}"
        )
        if median_bar is not None and middle > median_bar:
            survey.offenders.append(f"{name}: median {middle:g} lines (at most {median_bar})")
        if p90_bar is not None and tail > p90_bar:
            survey.offenders.append(f"{name}: 90 % have up to {tail:g} lines (at most {p90_bar})")
    return texts


def main(root: Path) -> int:
    """Survey the tree, print statistics and offenders; 0 when there are none."""
    survey = Survey()
    for path in sources(root):
        survey_file(survey, path, str(path.relative_to(root)))
    lines = summarise(survey)
    sys.stdout.write("\n".join([*lines, *survey.offenders]) + "\n")
    return 1 if survey.offenders else 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parents[1]))
