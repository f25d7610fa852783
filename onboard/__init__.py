"""Onboard autonomy: everything that runs on a robot."""
