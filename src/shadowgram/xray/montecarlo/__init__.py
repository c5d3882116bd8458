"""Photon transport for backscatter scanners: numba kernels, and the arrays they work on.

`arrays` says what goes in, `rng` where chance comes from, the `_…_kernels` modules take one physical step each, and
`run` is the only public door.
"""
