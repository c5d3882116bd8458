"""The benchmarks behind `shadowgram bench`: our times, a reference's in the same run, and what the machine could do.

- `run`: the groups of cases, and the run over them; `table`: the results for people.
- `timing`, `machine`, `work`: the clock, the machine's measured limits, the bytes and operations that a case cannot do without.
- `operators`, `solvers`, `scaling`, `memory`: the cases; `references`: the same computed with NumPy, PyWavelets and SciPy.
- `transport`: photon transport, with its own peer.
- `peers`: other packages, in a Python of their own.
"""
