"""Volumetric gain: our evaluation against the marching loop of GBPlanner, on the same maps and rays."""
