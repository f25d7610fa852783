"""A multirotor that behaves toward its companion like a PX4 does: same messages, refusals and failsafes."""
