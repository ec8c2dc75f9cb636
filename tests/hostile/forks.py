"""A process that has imported endolab and compiled its loops, and forks for every command it is given.

So a command begins at once, and what is killed is its work, not its imports. Nothing in this process may
start a thread, of which a fork would lack all but one; so Rerun is imported by the commands themselves.

It reads lines of JSON: ``{"argv": …, "folder": …}`` starts a command there, in a session of its own, with
its output in the files `out` and `err` beside the folder; the answer is its process. ``{"wait": …,
"seconds": …}`` is answered with its exit status, minus the signal that ended it, or null if it goes on.
"""

import atexit
import json
import os
import signal
import sys
import tempfile
import time
from pathlib import Path

import cv2

from tests.hostile.worker import opened

ENDED = []  # the exit status of a command that has ended


def leave():
    """End at once, as `endolab` does: Python's status would be an interrupt's that an `exec` survived."""
    if ENDED:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(ENDED[0])


def warm():
    """Import what commands use, and load the compiled loops."""
    import endolab as el
    import endolab.batch.calibrate
    import endolab.batch.sweep
    import endolab.batch.video
    import endolab.cli.main
    import endolab.io.sheet_video
    import endolab.plots.maps
    import endolab.reports.result

    cv2.setNumThreads(1)
    known = el.load_calibration("paper", width=32)
    scene = el.render(el.SCENES["colon"], known.camera, known.photometry)
    for how in ({"solver": "gauss_newton"}, {"solver": "primal_dual"}):
        result = el.reconstruct(el.Frame(scene.image, scene.mask), known, **how)
    with tempfile.TemporaryDirectory() as folder:
        el.save_result(result, Path(folder) / "out")
    tasks = Path("/proc/self/task")
    if tasks.is_dir() and len(list(tasks.iterdir())) > 1:
        raise RuntimeError("this process has threads, which a fork would lose")


def become(argv, folder):
    """Run a command in this process, as if it had been started in a folder; never returns."""
    os.setsid()
    os.chdir(folder)
    os.environ["TMPDIR"] = f"{folder}.tmp"
    os.environ["HOSTILE"] = folder  # by which processes that it starts are found
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    for descriptor, name in ((1, "out"), (2, "err")):
        os.dup2(os.open(f"{folder}.{name}", os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644), descriptor)
    sys.stdout, sys.stderr = opened(1), opened(2, errors="backslashreplace", buffering=1)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    from endolab.cli.main import main

    ENDED.append(main(argv))
    sys.exit(ENDED[0])


def ended(process, seconds):
    """Exit status of a process that ends within some seconds; None if it does not."""
    until = time.monotonic() + seconds
    while True:
        found, status = os.waitpid(process, os.WNOHANG)
        if found:
            return os.waitstatus_to_exitcode(status)
        if time.monotonic() > until:
            return None
        time.sleep(0.005)


def main(package=None):
    """Serve until there is no more input."""
    atexit.register(leave)  # called last, for it is the first
    requests, answers = os.fdopen(os.dup(0)), os.dup(1)
    os.dup2(2, 1)
    if package is not None:
        sys.path.insert(0, package)
    warm()
    os.write(answers, b"null\n")
    for line in requests:
        request = json.loads(line)
        if "wait" in request:
            answer = ended(request["wait"], request["seconds"])
        else:
            answer = os.fork()
            if answer == 0:
                become(request["argv"], request["folder"])
        os.write(answers, json.dumps(answer).encode() + b"\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
