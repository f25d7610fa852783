"""Flying: from paths to setpoints, within limits, and to a stop when anybody falls silent.

Nothing here imports numpy: the daemon has to be back within half a second of a crash, in flight.
"""
