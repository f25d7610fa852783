"""The compile cache follows the sources of all kernels."""

import os
import subprocess
import sys
from pathlib import Path

import numba
import pytest

from onboard.core.kernel_cache import KEPT_CACHES, kernel_digest, select_kernel_cache


def make_sources(folder: Path, kernel: str) -> Path:
    (folder / "onboard" / "deep").mkdir(parents=True, exist_ok=True)
    (folder / "simulation").mkdir(exist_ok=True)
    (folder / "onboard" / "deep" / "kernel.py").write_text(f"@njit\ndef f():\n    return {kernel}\n")
    (folder / "onboard" / "plain.py").write_text("x = 1\n")
    return folder


def test_digest_changes_with_any_kernel_and_nothing_else(tmp_path: Path) -> None:
    before = kernel_digest(make_sources(tmp_path, "1"))
    (tmp_path / "onboard" / "plain.py").write_text("x = 2\n")
    assert kernel_digest(tmp_path) == before
    assert kernel_digest(make_sources(tmp_path, "2")) != before


@pytest.fixture
def environment(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    for name in ("NUMBA_CACHE_DIR", "MARSUPIAL_CACHE_DIR"):
        monkeypatch.setenv(name, str(tmp_path / "cache"))
    monkeypatch.setattr(numba.config, "CACHE_DIR", numba.config.CACHE_DIR)
    return tmp_path / "cache"


def test_old_caches_are_pruned(environment: Path, tmp_path: Path) -> None:
    for version in range(KEPT_CACHES + 3):
        cache = select_kernel_cache(make_sources(tmp_path, str(version)))
        assert cache.parent == environment
        assert os.environ["NUMBA_CACHE_DIR"] == str(cache)
        cache.mkdir(parents=True)
        os.utime(cache, (version, version))
    assert len(list(environment.iterdir())) == KEPT_CACHES
    assert cache.exists()


def test_caches_that_may_be_in_use_are_not_pruned(environment: Path, tmp_path: Path) -> None:
    first = select_kernel_cache(make_sources(tmp_path, "0"))
    for version in range(KEPT_CACHES + 3):
        select_kernel_cache(make_sources(tmp_path, str(version))).mkdir(parents=True)
        os.utime(first, (1, 1))
        assert select_kernel_cache(make_sources(tmp_path, "0")) == first  # used again, at once
    assert len(list(environment.iterdir())) == KEPT_CACHES + 3


def test_child_process_uses_the_same_cache(environment: Path) -> None:
    code = "import onboard, os; print(os.environ['NUMBA_CACHE_DIR'])"
    root = Path(__file__).parents[2]
    lines = [
        subprocess.run(
            [sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=True
        ).stdout
        for _ in range(2)
    ]
    assert lines[0] == lines[1]
    assert Path(lines[0].strip()).parent == environment
