"""How well a legged base keeps to its path, and how fast a command reaches it."""
