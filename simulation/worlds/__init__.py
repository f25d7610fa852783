"""Worlds to explore: seeded generators, mesh files, and pictures of both."""

from simulation.worlds.catalog import GENERATORS, make_world, world_by_name
from simulation.worlds.drawing import draw_world
from simulation.worlds.files import load_world
from simulation.worlds.world import World

__all__ = ["GENERATORS", "World", "draw_world", "load_world", "make_world", "world_by_name"]
