"""LiDAR odometry."""
