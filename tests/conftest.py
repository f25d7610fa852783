"""What holds for all tests."""

from __future__ import annotations

from hypothesis import settings

# The first example of a test may compile kernels: no limit on its time.
settings.register_profile("marsupial", deadline=None)
settings.load_profile("marsupial")
