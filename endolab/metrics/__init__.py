"""How far a depth map is from the truth, and what of a picture a surface explains."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
