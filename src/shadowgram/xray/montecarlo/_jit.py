"""How the transport kernels are compiled.

Everything that one history runs through is inlined into the few functions that Python calls, the *entries*: a call
would copy the hundreds of words that the nested tuples of arrays consist of. Hence `forceinline`, and no cache of their
own for kernels (what numba takes from its cache it cannot inline); the entries are cached, under a key that changes
with any line of this folder (`SOURCES`).

`_nrt=False`: the kernels allocate nothing, so numba need not count references to all those arrays; counting and calling
made a history 20 times slower. `error_model="numpy"`: a division by zero gives an infinity instead of a branch.
`contract`: a multiplication and an addition may become one instruction; not in routines, whose sums are exact on purpose.
"""

import hashlib
from pathlib import Path

from numba import njit

kernel = njit(nogil=True, _nrt=False, error_model="numpy", fastmath={"contract"}, forceinline=True)  # pyright: ignore[reportCallIssue]
routine = njit(cache=True, nogil=True, _nrt=False, error_model="numpy")  # pyright: ignore[reportCallIssue]
"""For kernels that are long, take few arrays and lie with all that they call in one file: called, not inlined, and
cached on their own.
"""
entry = njit(cache=True, nogil=True, _nrt=False, error_model="numpy", fastmath={"contract"})  # pyright: ignore[reportCallIssue]


def _stamp() -> int:
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.read_bytes())
    return int.from_bytes(digest.digest()[:7], "big")


SOURCES = _stamp()
"""A number made of all sources in this folder. An entry is a closure over it, and numba's cache looks at what closures hold."""
