"""The size check must be able to fail: each rule catches a made-up offender."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture(scope="module")
def check_sizes() -> ModuleType:
    spec = importlib.util.spec_from_file_location("check_sizes", Path(__file__).parents[1] / "check_sizes.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["check_sizes"] = module
    spec.loader.exec_module(module)
    return module


def _tree(root: Path, text: str) -> Path:
    (root / "onboard").mkdir()
    (root / "onboard" / "module.py").write_text(text, encoding="utf-8")
    return root


CLEAN = "def f(a: int, *b: int, **c: int) -> int:\n    return a\n"


def test_clean_tree_passes(
    check_sizes: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert check_sizes.main(_tree(tmp_path, CLEAN)) == 0
    assert "functions     1  median 2" in capsys.readouterr().out


def test_empty_tree_passes(check_sizes: ModuleType, tmp_path: Path) -> None:
    assert check_sizes.main(tmp_path) == 0


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("def f(a) -> int:\n    return a\n", "lacks annotations: a"),
        ("def f(*a) -> int:\n    return 1\n", "lacks annotations: a"),
        ("def f(a: int):\n    return a\n", "lacks annotations: return"),
        ("class C:\n    def f(self, a) -> int:\n        return a\n", "lacks annotations: a"),
        ("def f() -> None:\n" + "    f()\n" * 60, "61 lines (max 60)"),
        ("x = 1\n" * 301, "301 lines (max 300)"),
        ("x = 1\n" * 150, "files: median 150 lines"),
        ("def f() -> None:\n" + "    f()\n" * 8, "functions: median 9 lines"),
        ("# TODO later\n", "TODO"),
        ("def f() -> None:\n    raise NotImplementedError\n", "NotImplementedError"),
        ("try:\n    x = 1\nexcept:\n    x = 2\n", "bare except"),
        ("try:\n    x = 1\nexcept Exception:\n    pass\n", "swallows"),
        ("try:\n    x = 1\nexcept OSError:\n    ...\n", "swallows"),
    ],
)
def test_offenders_are_named(
    check_sizes: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, complaint: str
) -> None:
    assert check_sizes.main(_tree(tmp_path, text)) == 1
    assert complaint in capsys.readouterr().out


@pytest.mark.parametrize("decorator", ["njit", "njit(cache=True)", "numba.njit", "cuda.jit"])
def test_kernels_may_be_long_but_not_untyped(check_sizes: ModuleType, tmp_path: Path, decorator: str) -> None:
    survey = check_sizes.Survey()
    path = tmp_path / "kernel.py"
    path.write_text(f"@{decorator}\ndef f(a) -> None:\n" + "    f(1)\n" * 80)
    check_sizes.survey_file(survey, path, "kernel.py")
    assert survey.kernels == [81]
    assert survey.functions == []
    assert survey.offenders == ["kernel.py:2: f lacks annotations: a"]


def test_docstrings_do_not_count(check_sizes: ModuleType, tmp_path: Path) -> None:
    survey = check_sizes.Survey()
    path = tmp_path / "module.py"
    path.write_text('def f() -> int:\n    """One.\n\n    Two.\n    """\n    return 1\n')
    check_sizes.survey_file(survey, path, "module.py")
    assert survey.functions == [2]


def test_tail_of_long_functions_is_caught(
    check_sizes: ModuleType, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    short = "".join(f"def f{i}() -> int:\n    return {i}\n" for i in range(8))
    long = "".join(f"def g{i}() -> None:\n" + f"    g{i}()\n" * 40 for i in range(2))
    assert check_sizes.main(_tree(tmp_path, short + long)) == 1
    assert "90 % have up to" in capsys.readouterr().out
