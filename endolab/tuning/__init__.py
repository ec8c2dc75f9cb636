"""The tuner: every parameter under a slider."""

from endolab._deprecated import with_old_names
from endolab._extras import need

need("ipywidgets", "anywidget")
__getattr__ = with_old_names(__name__)
