"""The tuner: every parameter under a slider."""

from endolab._extras import need

need("ipywidgets", "anywidget")
