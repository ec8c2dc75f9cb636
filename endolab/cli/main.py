"""endolab: see how one endoscope frame becomes 3D.

    reconstruct      Make a surface of a frame, or of each frame of a video.
    sweep            Make one table of errors and energies of many frames and settings.
    simulate         Render a scene: a frame with its truth.
    target           Draw a calibration sheet to print, at true size.
    calibrate        Make an endoscope.json of frames of a target.
    calibrate-light  Ask frames of tissue for the light's fall-off k.
    convert          Make an endoscope.json of another program's calibration.
    evaluate         Compare a depth map, or those of a folder, with the truth.
    tune             Open the tuner in the browser.
    lab              Open JupyterLab on the notebooks.

    --completion     Print what bash, zsh or fish needs to complete commands and options.
    --version        Print the version.

endolab COMMAND --help shows what a command takes, and examples.
"""

import gc
import os
import signal
import sys
import warnings
from collections.abc import Sequence
from typing import Any, Literal, NoReturn

from endolab import __version__
from endolab._extras import MissingPackage

# Where each is; nothing of it is loaded before it is called.
COMMANDS = (
    "reconstruct:reconstruct",
    "reconstruct:sweep",
    "simulate:simulate",
    "calibrate:target",
    "calibrate:calibrate",
    "calibrate:calibrate_light",
    "calibrate:convert",
    "evaluate:evaluate",
    "tune:tune",
    "lab:lab",
)

INTERRUPTED = 130  # as shells know it


def make_app() -> Any:
    """Make cyclopts' app of the commands: one function each, whose docstring is its help."""
    from cyclopts import App, Parameter

    app = App(
        "endolab",
        help_format="markdown",
        default_parameter=Parameter(negative=()),
        result_action="return_none",
        exit_on_error=False,
        print_error=False,
        suppress_keyboard_interrupt=False,
    )
    for place in COMMANDS:
        app.command(f"endolab.cli.{place}")

    @app.command(name="--completion")
    def completion(shell: Literal["bash", "zsh", "fish"], /) -> None:
        """Print what a shell needs to complete commands and options."""
        print(app.generate_completion(shell=shell))

    return app


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command: 0 when all is done, 2 after bad input, which is said in one sentence on stderr."""
    words = list(sys.argv[1:] if argv is None else argv)
    # Said at once: to load cyclopts takes longer.
    if words in ([], ["-h"], ["--help"], ["--version"]):
        print(f"endolab {__version__}" if words == ["--version"] else __doc__)
        return 0
    from cyclopts import CycloptsError

    try:
        make_app()(words)
        sys.stdout.flush()
    except BrokenPipeError:  # as after `| head -1`: nobody reads on
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141  # as shells know it
    except (CycloptsError, ValueError, OSError, MemoryError, MissingPackage) as error:
        from endolab.numerics.checks import shorten

        text = str(error) or "out of memory"
        if isinstance(error, OSError) and error.strerror:  # the system's own words
            text = f"{error.filename}: {error.strerror}"
        text = shorten(text.replace("overwrite=True", "--overwrite"), 600)
        print(f"endolab: {text}", file=sys.stderr)
        return 2
    except KeyboardInterrupt as error:
        text = str(error) or "interrupted; nothing was written"
        print(f"endolab: {text}", file=sys.stderr)
        return INTERRUPTED
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
    if (
        status == INTERRUPTED
    ):  # Python ends by the signal itself, where it came while a text was executed
        sys.stderr.flush()
        os._exit(status)
    raise SystemExit(status)
