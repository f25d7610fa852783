"""Onboard autonomy: everything that runs on a robot."""

from pathlib import Path

from onboard.core.kernel_cache import select_kernel_cache

select_kernel_cache(Path(__file__).parents[1])
