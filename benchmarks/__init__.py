"""Measurements that the documentation quotes, each repeatable with one command."""
