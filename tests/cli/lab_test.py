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

import pytest


@pytest.fixture(scope="module")
def started(tmp_path_factory):
    """What the command prints when its port is taken; the server's address, token and folder."""
    root = tmp_path_factory.mktemp("lab")
    for name in ("notebooks", "tmp"):
        (root / name).mkdir()
    # A home of its own, so that no settings of this machine's user matter.
    places = {"HOME": str(root), "TMPDIR": str(root / "tmp")}
    log = root / "log.txt"
    with socket.create_server(("127.0.0.1", 0)) as taken, open(log, "w") as stream:
        command = [sys.executable, "-m", "endolab", "lab"]
        command += [f"--port={taken.getsockname()[1]}"]
        command += [f"--notebooks={root / 'notebooks'}", "--", "--no-browser"]
        how = {"stdout": stream, "stderr": subprocess.STDOUT}
        server = subprocess.Popen(command, env=os.environ | places, **how)
        for _ in range(600):
            if "token=" in log.read_text() or server.poll() is not None:
                break
            time.sleep(0.1)
    yield server, log
    if server.poll() is None:
        server.kill()
        server.wait(20)


@pytest.fixture(scope="module")
def ask(started):
    """Function that asks the server for a path, with or without its token."""
    link = r"(http://\S+)/lab/tree/notebooks\?token=(\w+)"
    address, token = re.search(link, started[1].read_text()).groups()

    def get(path, with_token=True):
        headers = {"Authorization": f"token {token}"} if with_token else {}
        request = urllib.request.Request(address + path, headers=headers)
        with urllib.request.urlopen(request, timeout=30) as answer:
            return answer.read().decode()

    return get


def test_nobody_gets_in_without_the_token_and_the_kernel_is_this_python(ask):
    with pytest.raises(urllib.error.HTTPError, match="403"):
        ask("/api/contents", with_token=False)
    kernel = json.loads(ask("/api/kernelspecs"))["kernelspecs"]["endolab"]["spec"]
    assert kernel["argv"][0] == sys.executable


def test_nothing_pops_up(ask):
    assert '"buildCheck": false' in ask("/lab")
    path = "/lab/api/settings/@jupyterlab/apputils-extension:notification"
    defaults = json.loads(ask(path))["schema"]["properties"]
    assert defaults["fetchNews"]["default"] == "false"
    assert defaults["checkForUpdates"]["default"] is False


def test_the_server_listens_to_this_machine_alone_and_hides_its_token(started, ask):
    import psutil

    server, log = started
    process = psutil.Process(server.pid)
    open_ports = process.net_connections("tcp")
    own = {at.laddr.ip for at in open_ports if at.status == psutil.CONN_LISTEN}
    assert own == {"127.0.0.1"}
    token = re.search(r"token=(\w+)", log.read_text())[1]
    assert token not in " ".join(process.cmdline())


def test_it_ends_when_it_is_told_to_and_leaves_nothing(started):
    server, log = started
    scratch = log.parent / "tmp"
    assert len(list(scratch.glob("endolab-lab-*"))) == 1
    server.send_signal(signal.SIGTERM)
    server.wait(30)
    assert not list(scratch.glob("endolab-lab-*"))
    assert "Traceback" not in log.read_text()
