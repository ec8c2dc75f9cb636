"""Recordings for the Rerun viewer, of every iterate, and their way back."""

from endolab._deprecated import with_old_names
from endolab._extras import need

need("rerun")
__getattr__ = with_old_names(__name__)
