"""JupyterLab on the notebooks: no pop-ups, no network, no foreign script, a free port, its own kernel."""

import json
import os
import secrets
import socket
import sqlite3
import sys
import tempfile
from collections.abc import Iterable, Sequence
from contextlib import closing, suppress
from pathlib import Path

from endolab._extras import need

# Of endolab's checkout, where there is one.
OWN_NOTEBOOKS = Path(__file__).resolve().parents[2] / "notebooks"
PORTS = 50  # that are tried, one after the other


def write_settings(folder: str | os.PathLike[str]) -> None:
    """Write what keeps JupyterLab quiet into a folder of its configuration, as ``.venv/etc/jupyter``."""
    config = Path(folder) / "labconfig"
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


def write_kernel(folder: str | os.PathLike[str]) -> None:
    """Write a kernel named endolab, of this Python, among Jupyter's data: ``.venv/share/jupyter``."""
    kernel = Path(folder) / "kernels" / "endolab"
    kernel.mkdir(parents=True, exist_ok=True)
    # Without frozen modules, for else the debugger warns in the first cell.
    command = [
        sys.executable,
        "-Xfrozen_modules=off",
        "-m",
        "ipykernel_launcher",
        "-f",
        "{connection_file}",
    ]
    content = {
        "argv": command,
        "display_name": "endolab",
        "language": "python",
        "metadata": {"debugger": True},
    }
    (kernel / "kernel.json").write_text(json.dumps(content), encoding="utf-8")


def free_port(first: int) -> int:
    """Find the first port from `first` on that nobody listens to; OSError if all that are tried are taken."""
    if not 1 <= first <= 65535:
        raise ValueError(f"--port must be from 1 to 65535, got {first}")
    last = min(first + PORTS - 1, 65535)
    for port in range(first, last + 1):
        with socket.socket() as listener:
            if (
                os.name == "posix"
            ):  # as Jupyter does; else a port stays taken for a minute after its last use
                listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                listener.bind(("127.0.0.1", port))
            except OSError:
                continue
            return port
    raise OSError(
        f"all ports from {first} to {last} are taken; name another one with --port"
    )


def _prepend(variable: str, folder: Path) -> None:
    others = os.environ.get(variable)
    os.environ[variable] = f"{folder}{os.pathsep}{others}" if others else str(folder)


def _sign(notebooks: Iterable[Path]) -> None:
    """Sign endolab's own notebooks as they are delivered, so that JupyterLab does not call them untrusted.

    A signature is one of the content, wherever it lies: copies have it too, and nothing else has. One with
    outputs or with the state of widgets, in which scripts could wait, is signed by JupyterLab alone, when
    its cells were run here and it is saved.
    """
    from nbformat import ValidationError, read
    from nbformat.sign import NotebookNotary

    notary = NotebookNotary()
    with closing(notary.store):
        for path in notebooks:
            try:
                notebook = read(path, as_version=4)
            except (
                ValueError,
                OSError,
                ValidationError,
            ):  # not a notebook: JupyterLab will say so
                continue
            if "widgets" not in notebook.metadata and not any(
                cell.get("outputs") for cell in notebook.cells
            ):
                notary.sign(notebook)


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
    token = os.environ.pop("JUPYTER_TOKEN", "") or secrets.token_hex(24)
    with tempfile.TemporaryDirectory(prefix="endolab-lab-") as scratch:
        home = Path(scratch)
        write_settings(home)
        write_kernel(home)
        # a file is private, a command line is not.
        (home / "token").write_text(token, encoding="utf-8")
        os.environ["JUPYTER_TOKEN_FILE"] = str(home / "token")
        _prepend("JUPYTER_CONFIG_PATH", home)
        _prepend("JUPYTER_PATH", home)
        # The Rerun viewer's assets then come from this machine; it must be set before rerun is imported.
        os.environ.setdefault("RERUN_NOTEBOOK_ASSET", "serve-local")
        asked = [
            f"--notebook-dir={folder.parent}",
            f"--LabApp.default_url=/lab/tree/{folder.name}",
        ]
        asked += ["--ip=127.0.0.1", f"--port={free}", "--ServerApp.port_retries=0"]
        asked += ["--LabApp.extension_manager=readonly"]
        # One line with the link is printed in place of Jupyter's thirty.
        asked += ["--log-level=WARN", "--LabApp.log_level=WARN"]
        if (
            hasattr(os, "geteuid") and os.geteuid() == 0
        ):  # in a container; Jupyter would refuse
            asked.append("--allow-root")

        from jupyter_core.application import NoStart
        from jupyterlab.labapp import LabApp  # type: ignore[import-untyped]

        with suppress(
            OSError, sqlite3.Error
        ):  # no place for signatures: JupyterLab trusts none
            _sign(OWN_NOTEBOOKS.glob("[0-9][0-9]_*.ipynb"))
        with suppress(NoStart):
            server = LabApp.initialize_server([*asked, *options])
            link = f"http://127.0.0.1:{free}/lab/tree/{folder.name}?token={token}"
            taken = f" (port {port} is taken)" if free != port else ""
            print(f"JupyterLab: {link}{taken}", flush=True)
            server.start()


if (
    __name__ == "__main__"
):  # python -m endolab.cli.lab .venv, for a JupyterLab that is started by hand
    write_settings(Path(sys.argv[1]) / "etc" / "jupyter")
    write_kernel(Path(sys.argv[1]) / "share" / "jupyter")
