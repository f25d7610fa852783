"""The embedded simulator: worlds, sensors, robots, radio and the lock-step mission runner."""

import onboard as onboard  # selects the kernel cache before any kernel of ours is compiled
