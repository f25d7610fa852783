"""`python -m simulation.px4 [--instance I] [--seed S] [--speed F] [--key FILE] [NAME=VALUE ...]`."""

from __future__ import annotations

import argparse
import contextlib
from pathlib import Path

from simulation.px4.process import serve


def _parameter(text: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    return name, float(value)


def main() -> None:
    """Run one vehicle until it is interrupted."""
    parser = argparse.ArgumentParser(prog="simulation.px4", description=__doc__)
    parser.add_argument("--instance", type=int, default=0, help="added to every port; the system is this + 1")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--speed", type=float, default=1.0, help="simulated seconds per second")
    parser.add_argument("--key", type=Path, help="file that begins with the 32 bytes of a signing key")
    parser.add_argument("parameters", nargs="*", type=_parameter, metavar="NAME=VALUE")
    given = parser.parse_args()
    key = given.key.read_bytes()[:32] if given.key else None
    with contextlib.suppress(KeyboardInterrupt):
        serve(dict(given.parameters), given.instance, given.seed, given.speed, key)


if __name__ == "__main__":
    main()
