"""The processes of a robot: cores put together with drivers."""
