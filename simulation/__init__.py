"""The embedded simulator: worlds, sensors, robots, radio and the lock-step mission runner."""
