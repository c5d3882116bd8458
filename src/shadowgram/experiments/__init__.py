"""Runs that put the pieces together: the demo, and later the studies."""
