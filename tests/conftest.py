"""What holds for all tests."""

from __future__ import annotations

import os

from hypothesis import settings

# The first example of a test may compile kernels: no limit on its time. The examples are the same in every
# run unless HYPOTHESIS_PROFILE=search asks for new ones.
settings.register_profile("marsupial", deadline=None, derandomize=True)
settings.register_profile("search", deadline=None, max_examples=1000)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "marsupial"))
