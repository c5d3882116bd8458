"""Reconstruction algorithms, one a file."""
