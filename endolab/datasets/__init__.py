"""Published frames with truth, and the endoscopes that endolab knows by name."""

import lazy_loader

from endolab._deprecated import with_old_names

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__getattr__ = with_old_names(__name__, __getattr__)
