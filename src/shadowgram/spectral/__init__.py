"""Spectral imagers: SSCSI, CASSI, dual-disperser and colored CASSI; what they resolve, the bench they stand on, calibration."""

import lazy_loader as _lazy

__getattr__, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)
