"""One compile cache per state of the sources.

numba caches a compiled kernel by the time stamp of its own file alone, although other files' kernels are
inlined into it: after an update a robot would run old code. So the cache's folder is named after all kernels.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import sys
import time
from pathlib import Path

KEPT_CACHES = 4
IN_USE_S = 86_400.0
"""A cache that was selected within a day may belong to a program that runs; it is not pruned."""


def select_kernel_cache(packages: Path) -> Path:
    """Point numba to the cache of the current sources (all kernels below `packages`) and prune old ones.

    The base folder is NUMBA_CACHE_DIR if set, else `marsupial` in the user's cache folder.
    """
    given = os.environ.get("MARSUPIAL_CACHE_DIR") or os.environ.get("NUMBA_CACHE_DIR")
    home = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    base = Path(given) if given else Path(home) / "marsupial"
    os.environ["MARSUPIAL_CACHE_DIR"] = str(base)  # child processes must not nest their cache in ours
    cache = base / f"kernels-{kernel_digest(packages)}"
    os.environ["NUMBA_CACHE_DIR"] = str(cache)
    if "numba" in sys.modules:
        sys.modules["numba"].config.CACHE_DIR = str(cache)
    if cache.exists():
        os.utime(cache)
    else:
        _prune(base)
    return cache


def kernel_digest(packages: Path) -> str:
    """Digest of all sources with compiled kernels in the folders beside each other in `packages`."""
    digest = hashlib.sha256()
    for package in ("onboard", "simulation"):
        for path in sorted((packages / package).rglob("*.py")):
            source = path.read_bytes()
            if b"@njit" in source:
                digest.update(path.relative_to(packages).as_posix().encode() + b"\0" + source)
    return digest.hexdigest()[:16]


def _prune(base: Path) -> None:
    caches = sorted(base.glob("kernels-*"), key=lambda path: path.stat().st_mtime, reverse=True)
    now_s = time.time()
    for old in caches[KEPT_CACHES - 1 :]:
        if now_s - old.stat().st_mtime > IN_USE_S:
            shutil.rmtree(old, ignore_errors=True)
