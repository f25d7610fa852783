"""How fast planners explore: ours beside the rules of GBPlanner and the nearest frontier, in closed loop."""
