"""The command line: one function a command, its docstring the help."""

import gc
import os
import signal
import sys
import warnings
from collections.abc import Sequence
from typing import Literal, NoReturn

from cyclopts import App, CycloptsError, Parameter

from endolab import __version__
from endolab._extras import MissingPackage
from endolab.cli.calibrate import calibrate, calibrate_light, convert, target
from endolab.cli.evaluate import evaluate
from endolab.cli.lab import lab
from endolab.cli.reconstruct import reconstruct, sweep
from endolab.cli.simulate import simulate
from endolab.cli.tune import tune

COMMANDS = (
    reconstruct,
    sweep,
    simulate,
    target,
    calibrate,
    calibrate_light,
    convert,
    evaluate,
    tune,
    lab,
)

app = App(
    "endolab",
    help="See how one endoscope frame becomes 3D.",
    version=f"endolab {__version__}",
    help_format="markdown",
    default_parameter=Parameter(negative=()),
    result_action="return_none",
    exit_on_error=False,
    print_error=False,
    suppress_keyboard_interrupt=False,
)
for command in COMMANDS:
    app.command(command)


@app.command(name="--completion")
def completion(shell: Literal["bash", "zsh", "fish"], /) -> None:
    """Print what a shell needs to complete commands and options."""
    print(app.generate_completion(shell=shell))


def to_one_line(error: Exception) -> str:
    """Return what an error says in one printable line, without the middle of what is too long."""
    from endolab.numerics.checks import shorten

    text = str(error) or "out of memory"
    if isinstance(error, OSError) and error.strerror:  # the system's own words
        text = f"{error.filename}: {error.strerror}"
    return shorten(text.replace("overwrite=True", "--overwrite"), 600)


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command: 0 when all is done, 2 after bad input, which is said in one sentence on stderr."""
    try:
        app(argv)
        sys.stdout.flush()
    except BrokenPipeError:  # as after `| head -1`: nobody reads on
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141  # as shells know it
    except (CycloptsError, ValueError, OSError, MemoryError, MissingPackage) as error:
        print(f"endolab: {to_one_line(error)}", file=sys.stderr)
        return 2
    except KeyboardInterrupt as error:
        text = str(error) or "interrupted; nothing was written"
        print(f"endolab: {text}", file=sys.stderr)
        return 130  # as shells know it
    return 0


def run() -> NoReturn:
    """Run a command as a process of its own, which ends on SIGTERM and SIGHUP as on Ctrl-C."""
    for name in ("SIGTERM", "SIGHUP"):
        if signal.getsignal(getattr(signal, name)) is signal.SIG_DFL:  # not so with nohup
            signal.signal(getattr(signal, name), signal.default_int_handler)
    if not sys.warnoptions:  # others' warnings say nothing to its user
        warnings.filterwarnings("ignore", module=r"(?!endolab\b)")
    # Of a disk that is full Rerun complains on its own, before `recording.stream.Sink` says so in a sentence.
    os.environ.setdefault("RUST_LOG", "warn,re_log_encoding=off,re_sdk=off")
    # What is imported stays: to look through it takes a sixth of the time of a frame.
    gc.set_threshold(50_000)
    status = main()
    gc.freeze()
    raise SystemExit(status)
