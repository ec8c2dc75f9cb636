"""endolab: see how one endoscope frame becomes 3D.

    import endolab as el
    calibration = el.load_calibration("endoscope.json")
    frame = el.read_frame("frame.png", calibration)
    result = el.reconstruct(frame, calibration, observers=[el.record("run.rrd")])

Names are loaded when they are first used, so that importing endolab costs nothing; ``__init__.pyi``
lists them, for editors and type checkers too.
"""

import lazy_loader

from endolab._extras import check_opencv

check_opencv()
__version__ = "0.2.0"
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
