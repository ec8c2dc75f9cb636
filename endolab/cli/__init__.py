"""The command line: it parses, calls and prints."""

from endolab._deprecated import with_old_names

__getattr__ = with_old_names(__name__)
