"""Coded-aperture imaging from visible light to X-rays.

The data flow, and the order in which the subpackages import one another:
scene (`scenes`) → imager (`codes`, `spectral` → `operators`) → measurement (operator, then `noise`)
→ reconstruction (`priors`, `solvers`) → `metrics` → `figures`.

Every name is loaded when it is first used, so that `import shadowgram` stays fast.
"""

import lazy_loader as _lazy

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)
