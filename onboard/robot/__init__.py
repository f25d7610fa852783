"""One robot's whole autonomy as a core that is stepped: sensors and frames in, commands and frames out."""
