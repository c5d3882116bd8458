"""X-ray backscatter scanners: materials, spectra, scenes, the transport of photons, and the scans of a coded mask.

Lengths are mm, energies keV, cross sections barn, attenuation cm²/g and 1/cm, doses Gy.
"""

import lazy_loader as _lazy

__getattr__, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)
