"""Coded apertures, uint8, (shot, y, x): patterns, classical families, designs for an imager, statistics, and mask files."""

import lazy_loader as _lazy

__getattr__, __dir__, __all__ = _lazy.attach_stub(__name__, __file__)
