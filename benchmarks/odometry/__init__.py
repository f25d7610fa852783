"""Drift, speed and honesty of the LiDAR odometry beside others, on simulated walks and flights."""
