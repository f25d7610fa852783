"""Speed, fidelity and memory of the voxel map beside other maps."""
