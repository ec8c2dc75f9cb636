"""JupyterLab on the notebooks: no pop-ups, no network, no foreign script, a free port, its own kernel."""

import os
import shutil
import sys
import tempfile
from pathlib import Path

from endolab._extras import need
from endolab.cli.solving import Port, free_port, tunnel


def set_up(prefix: str) -> None:
    """Write what keeps JupyterLab quiet, and a kernel named endolab, into a prefix, as ``.venv``."""
    from ipykernel.kernelspec import write_kernel_spec

    config = Path(prefix, "etc/jupyter/labconfig")
    config.mkdir(parents=True, exist_ok=True)
    # Open3D brings a Dash extension, for which JupyterLab would ask, over the whole page, to be built again.
    page = '{"buildCheck": false, "buildAvailable": false}'
    (config / "page_config.json").write_text(page)
    news = """{"@jupyterlab/apputils-extension:notification":
{"fetchNews": "false", "checkForUpdates": false, "doNotDisturbMode": true}}"""
    (config / "default_setting_overrides.json").write_text(news)
    kernel = Path(prefix, "share/jupyter/kernels/endolab")
    shutil.rmtree(kernel, ignore_errors=True)
    # Without frozen modules, for else the debugger warns in the first cell.
    thawed = ["-Xfrozen_modules=off"]
    write_kernel_spec(kernel, {"display_name": "endolab"}, python_arguments=thawed)


def lab(*jupyter: str, notebooks: str | None = None, port: Port = 8888) -> None:
    """Open JupyterLab on the notebooks.

    - endolab lab
    - endolab lab --notebooks mine --port 9000 -- --no-browser

    Parameters
    ----------
    jupyter : str
        Options passed on to JupyterLab, after --.
    notebooks : path
        Other notebooks than endolab's own; their parent is shown too.
    port : int
        Where to listen, or on the next that is free.
    """
    need("jupyterlab")
    own = Path(__file__).parents[2] / "notebooks"  # of a checkout, where there is one
    folder = Path(notebooks or own).resolve()
    if not folder.is_dir():
        raise FileNotFoundError(
            f"{folder}: there are no notebooks; name some by --notebooks"
        )
    port = free_port(port)
    with tempfile.TemporaryDirectory(prefix="endolab-lab-") as scratch:
        set_up(scratch)
        os.environ["JUPYTER_CONFIG_PATH"] = f"{scratch}/etc/jupyter"
        os.environ["JUPYTER_PATH"] = f"{scratch}/share/jupyter"
        # The Rerun viewer's assets then come from this machine; it must be set before rerun is imported.
        os.environ.setdefault("RERUN_NOTEBOOK_ASSET", "serve-local")
        options = [
            f"--notebook-dir={folder.parent}",
            f"--LabApp.default_url=/lab/tree/{folder.name}",
            "--ip=127.0.0.1",
            f"--port={port}",
            "--LabApp.extension_manager=readonly",
            "--log-level=WARN",  # the link alone is printed
            "--LabApp.log_level=WARN",
            "--allow-root",  # as in a container
        ]
        remote = tunnel(port)
        if remote:
            options.append("--no-browser")
            print(remote, flush=True)
        from jupyterlab.labapp import LabApp  # type: ignore[import-untyped]

        LabApp.launch_instance([*options, *jupyter])


if __name__ == "__main__":  # with .venv, for a JupyterLab that is started by hand
    set_up(sys.argv[1])
