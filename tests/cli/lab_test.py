"""What ``endolab lab`` starts: quiet, private, on a free port."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

import pytest

from endolab.cli import lab
from endolab.cli import main as cli

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def started(tmp_path_factory):
    """What the command prints when its port is taken; the server's address, token and folder."""
    root = tmp_path_factory.mktemp("lab")
    (root / "notebooks").mkdir()
    # A home of its own, so that no settings of this machine's user matter.
    places = {"PYTHONPATH": ROOT, "HOME": root, "TMPDIR": root / "tmp"}
    environment = os.environ | {name: str(place) for name, place in places.items()}
    (root / "tmp").mkdir()
    log = root / "log.txt"
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        command = [sys.executable, "-m", "endolab", "lab", f"--port={port}"]
        command += [f"--notebooks={root / 'notebooks'}", "--", "--no-browser"]
        with open(log, "w") as stream:
            server = subprocess.Popen(
                command, env=environment, stdout=stream, stderr=subprocess.STDOUT
            )
        for _ in range(600):
            if "JupyterLab: " in log.read_text() or server.poll() is not None:
                break
            time.sleep(0.1)
    yield server, port, log
    if server.poll() is None:
        server.kill()
        server.wait(20)


@pytest.fixture(scope="module")
def ask(started):
    """Function that asks the server for a path, with or without its token."""
    link = r"(http://\S+)/lab/tree/notebooks\?token=(\w+)"
    address, token = re.search(link, started[2].read_text()).groups()

    def get(path, with_token=True):
        headers = {"Authorization": f"token {token}"} if with_token else {}
        request = urllib.request.Request(address + path, headers=headers)
        with urllib.request.urlopen(request, timeout=30) as answer:
            return answer.read().decode()

    return get


def test_a_taken_port_is_said_in_the_one_line_that_is_printed(started):
    _, port, log = started
    lines = log.read_text().splitlines()
    link = r"JupyterLab: http://127\.0\.0\.1:(\d+)/lab/tree/notebooks\?token=\w{48} \(port (\d+) is taken\)"
    assert len(lines) == 1, lines
    found = re.fullmatch(link, lines[0])
    assert found, lines
    assert int(found[2]) == port
    assert port < int(found[1]) < port + lab.PORTS


def test_nobody_gets_in_without_the_token(ask):
    with pytest.raises(urllib.error.HTTPError, match="403"):
        ask("/api/contents", with_token=False)


def test_nothing_pops_up(ask):
    data = r'id="jupyter-config-data" type="application/json">(.*?)</script>'
    config = json.loads(re.search(data, ask("/lab"), re.S)[1])
    assert (config["buildCheck"], config["buildAvailable"]) == (False, False)
    plugin = json.loads(
        ask("/lab/api/settings/@jupyterlab/apputils-extension:notification")
    )
    defaults = {
        name: value["default"] for name, value in plugin["schema"]["properties"].items()
    }
    assert (defaults["fetchNews"], defaults["checkForUpdates"]) == ("false", False)


def test_the_kernel_named_endolab_is_this_python(ask):
    kernel = json.loads(ask("/api/kernelspecs"))["kernelspecs"]["endolab"]["spec"]
    assert (kernel["argv"][0], kernel["display_name"]) == (sys.executable, "endolab")


def test_the_server_listens_to_this_machine_alone_and_hides_its_token(started, ask):
    import psutil

    server, _, log = started
    process = psutil.Process(server.pid)
    open_ports = process.net_connections("tcp")
    own = {at.laddr.ip for at in open_ports if at.status == psutil.CONN_LISTEN}
    assert own == {"127.0.0.1"}
    token = re.search(r"token=(\w+)", log.read_text())[1]
    assert token not in " ".join(process.cmdline())
    assert log.read_text().count(token) == 1  # in the line that is printed


def test_it_ends_when_it_is_told_to_and_leaves_nothing(started):
    server, _, log = started
    scratch = log.parent / "tmp"
    assert len(list(scratch.glob("endolab-lab-*"))) == 1
    server.send_signal(signal.SIGTERM)
    server.wait(30)
    assert not list(scratch.glob("endolab-lab-*"))
    assert "Traceback" not in log.read_text()


def test_bad_input_is_answered_in_a_line(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(lab, "PORTS", 1)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        for folder, number, named in (
            ("none", port, "none"),
            (".", 70000, "--port"),
            (".", port, str(port)),
        ):
            assert (
                cli.main(
                    ["lab", f"--notebooks={tmp_path / folder}", f"--port={number}"]
                )
                == 2
            )
            error = capsys.readouterr().err
            assert (named in error, error.count("\n")) == (True, 1)


def test_a_notebook_that_was_copied_alone_finds_its_checks(tmp_path, monkeypatch):
    from jupyter_core.application import NoStart
    from jupyterlab.labapp import LabApp

    def leave(*_):
        raise NoStart

    for name in ("JUPYTER_CONFIG_PATH", "JUPYTER_PATH"):
        monkeypatch.setenv(name, "")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setattr(LabApp, "initialize_server", leave)
    lab.open_lab(tmp_path)
    command = [sys.executable, "-c", "from checks import quickstart"]
    subprocess.run(command, cwd=tmp_path, check=True)
