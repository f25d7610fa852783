"""Voxel map, its kernels, distance and gain."""
