"""JupyterLab on the notebooks: no pop-ups, no network, no foreign script, a free port, its own kernel."""

import json
import os
import shutil
import socket
import sys
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from endolab._extras import need

# Of endolab's checkout, where there is one.
OWN_NOTEBOOKS = Path(__file__).resolve().parents[2] / "notebooks"
PORTS = 50  # that are tried, one after the other


def set_up(prefix: str | os.PathLike[str]) -> None:
    """Write what keeps JupyterLab quiet, and a kernel named endolab, into a prefix, as ``.venv``."""
    from ipykernel.kernelspec import write_kernel_spec

    config = Path(prefix) / "etc" / "jupyter" / "labconfig"
    config.mkdir(parents=True, exist_ok=True)
    # Open3D brings a Dash extension, for which JupyterLab would ask, over the whole page, to be built again.
    settings = {
        "page_config": {"buildCheck": False, "buildAvailable": False},
        "default_setting_overrides": {
            "@jupyterlab/apputils-extension:notification": {
                "fetchNews": "false",
                "checkForUpdates": False,
                "doNotDisturbMode": True,
            }
        },
    }
    for name, content in settings.items():
        (config / f"{name}.json").write_text(json.dumps(content), encoding="utf-8")
    kernel = Path(prefix) / "share" / "jupyter" / "kernels" / "endolab"
    shutil.rmtree(kernel, ignore_errors=True)
    # Without frozen modules, for else the debugger warns in the first cell.
    thawed = ["-Xfrozen_modules=off"]
    write_kernel_spec(kernel, {"display_name": "endolab"}, python_arguments=thawed)


def free_port(first: int) -> int:
    """Find the first port from `first` on that nobody listens to; OSError if all that are tried are taken."""
    if not 1 <= first <= 65535:
        raise ValueError(f"--port must be from 1 to 65535, got {first}")
    last = min(first + PORTS - 1, 65535)
    for port in range(first, last + 1):
        with suppress(OSError), socket.create_server(("127.0.0.1", port)):
            return port
    raise OSError(
        f"all ports from {first} to {last} are taken; name another one with --port"
    )


def open_lab(
    notebooks: str | os.PathLike[str] | None = None,
    port: int = 8888,
    options: Sequence[str] = (),
) -> None:
    """Run JupyterLab until it is told to stop; print the link to it.

    `notebooks` is the folder that is opened, by default that of endolab's checkout; `port` is where to
    listen, or on the next that is free; `options`, such as ``--no-browser``, are passed on. OSError if
    there are no notebooks or no port is free, `MissingPackage` if JupyterLab is not installed.
    """
    need("jupyterlab")
    folder = OWN_NOTEBOOKS if notebooks is None else Path(notebooks).resolve()
    if not folder.is_dir():
        wanted = "run this from a checkout of endolab, or name a folder with --notebooks"
        raise FileNotFoundError(f"{folder}: there are no notebooks; {wanted}")
    free = free_port(port)
    with tempfile.TemporaryDirectory(prefix="endolab-lab-") as scratch:
        set_up(scratch)
        own = {
            "JUPYTER_CONFIG_PATH": os.path.join(scratch, "etc", "jupyter"),
            "JUPYTER_PATH": os.path.join(scratch, "share", "jupyter"),
            # Where a notebook that was copied alone finds `checks`.
            "PYTHONPATH": str(OWN_NOTEBOOKS),
        }
        for variable, place in own.items():
            folders = [place, os.environ.get(variable)]
            os.environ[variable] = os.pathsep.join(filter(None, folders))
        # The Rerun viewer's assets then come from this machine; it must be set before rerun is imported.
        os.environ.setdefault("RERUN_NOTEBOOK_ASSET", "serve-local")
        asked = [
            f"--notebook-dir={folder.parent}",
            f"--LabApp.default_url=/lab/tree/{folder.name}",
            "--ip=127.0.0.1",
            f"--port={free}",
            "--ServerApp.port_retries=0",
            "--LabApp.extension_manager=readonly",
            # One line with the link is printed in place of Jupyter's thirty.
            "--log-level=WARN",
            "--LabApp.log_level=WARN",
            "--allow-root",  # as in a container
        ]

        from jupyter_core.application import NoStart
        from jupyterlab.labapp import LabApp  # type: ignore[import-untyped]

        with suppress(NoStart):
            server = LabApp.initialize_server([*asked, *options])
            token = server.identity_provider.token  # of Jupyter's making, or the caller's
            server.identity_provider.token_generated = False  # or Jupyter says it once more
            link = f"http://127.0.0.1:{free}/lab/tree/{folder.name}?token={token}"
            taken = f" (port {port} is taken)" if free != port else ""
            print(f"JupyterLab: {link}{taken}", flush=True)
            server.start()


if __name__ == "__main__":  # with .venv, for a JupyterLab that is started by hand
    set_up(sys.argv[1])
