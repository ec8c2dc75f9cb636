"""The light, from how bright the paper is.

Read `samples`, `model`, `fit`, `result`, `identifiability`.
"""

from endolab._deprecated import with_old_names

__getattr__ = with_old_names(__name__)
