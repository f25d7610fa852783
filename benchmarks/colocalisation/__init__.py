"""Does the aerial robot find itself in the ground robot's map? `python -m benchmarks.colocalisation`."""
