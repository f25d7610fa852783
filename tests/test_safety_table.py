"""The failsafe table of docs/safety.md: every row names a test that exists."""

from __future__ import annotations

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "docs" / "safety.md").read_text(encoding="utf-8")


def rows() -> list[str]:
    """Lines of the failsafe table without its head."""
    table = TEXT.split("\n## Failsafes\n")[1].split("\n## ")[0]
    return [line for line in table.splitlines() if line.startswith("|")][2:]


def functions(path: Path) -> set[str]:
    return {node.name for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.FunctionDef)}


def test_every_row_names_tests_that_exist():
    assert len(rows()) >= 20
    for row in rows():
        named = re.findall(r"`(tests/[\w/]+\.py)::(test_\w+)`", row.split("|")[-2])
        assert named, row
        for path, test in named:
            assert test in functions(ROOT / path), row
