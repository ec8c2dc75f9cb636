"""The Rerun viewer in a notebook, for this machine only."""

import contextlib
import io
import os
import sys
from typing import Any


def front_end() -> bool:
    """Whether someone looks at this notebook; a test or a script that runs one shows no widgets."""
    # Told to kernels by those who show what they say: Jupyter's server, VS Code, Colab.
    names = ("JPY_SESSION_NAME", "VSCODE_PID", "COLAB_RELEASE_TAG")
    return "ipykernel" in sys.modules and any(os.environ.get(name) for name in names)


def notebook_viewer() -> Any:
    """Rerun's module for notebooks, with its program served by this machine."""
    os.environ.setdefault("RERUN_NOTEBOOK_ASSET", "serve-local")
    with contextlib.redirect_stdout(io.StringIO()):  # it tells of every step
        import rerun_notebook  # type: ignore[import-untyped]
    return rerun_notebook
