"""Proximal maps and denoisers, as callables."""
