"""The tuner: every parameter under a slider."""

from endolab._deprecated import with_old_names

__getattr__ = with_old_names(__name__)
