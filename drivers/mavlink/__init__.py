"""MAVLink 2 toward an autopilot: dialect, frames, signatures, and the state machines of a vehicle link."""
