"""LiDAR odometry, co-localisation, and the back end that closes loops."""
