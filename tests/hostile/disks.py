"""Classes of cases: disks that are full, small or read-only, below every command that writes.

A disk is a piece of memory that is mounted in the case's folder. That takes a user who may mount: `PREFIX`
makes the worker one, in a namespace of its own, so that nothing of it is seen or left outside.
"""

import os
import shutil
import subprocess
from pathlib import Path

from tests.hostile.case import command
from tests.hostile.damage import pick
from tests.hostile.damaged_files import QUICK

PREFIX = ("unshare", "--mount", "--map-root-user")
# Of each command: its words, and what it writes on the disk.
COMMANDS = (
    (("reconstruct", "frame.png", "--calibration", "endoscope.json", *QUICK, "--out", "disk/out"), "out"),
    (("reconstruct", "frame.png", "--calibration", "endoscope.json", "--mesh", "--out", "disk/out"), "out"),
    (("reconstruct", "pictures", "--calibration", "cal.json", *QUICK, "--out", "disk/out"), "out"),
    (
        (
            "sweep",
            "frame.png",
            "--calibration",
            "endoscope.json",
            *QUICK,
            "--lam",
            "1,2,3",
            "--out",
            "disk/t.csv",
        ),
        "t.csv",
    ),
    (("simulate", "tube", "--calibration", "cal.json", "--width", 64, "--out", "disk/out"), "out"),
    (
        ("simulate", "sheet", "--calibration", "cal.json", "--width", 64, "--frames", 3, "--out", "disk/out"),
        "out",
    ),
    (
        (
            "simulate",
            "sheet",
            "--calibration",
            "cal.json",
            "--width",
            64,
            "--frames",
            9,
            "--video",
            "--out",
            "disk/out",
        ),
        "out",
    ),
    (("target", "vicalib_small", "--out", "disk/sheet.pdf"), "sheet.pdf"),
    (("target", "vicalib_small", "--out", "disk/sheet.svg"), "sheet.svg"),
    (("convert", "geometry.xml", "photometry.xml", "--out", "disk/c.json"), "c.json"),
    (("calibrate", "sheet", "--target", "vicalib_small", "--out", "disk/new.json"), "new.json"),
)
# What may be there although the command failed: rows and frames that are done, and what was searched.
GROWING = {"sweep": ("t.csv",), "calibrate": ("new_report",), "pictures": ("out",)}


def allowed():
    """Whether a disk can be mounted here."""
    try:
        done = subprocess.run(
            [*PREFIX, "mount", "-t", "tmpfs", "none", "/mnt"], capture_output=True, check=False
        )
    except OSError:
        return False
    return done.returncode == 0


def _mount(*options):
    Path("disk").mkdir(exist_ok=True)
    subprocess.run(["mount", "-t", "tmpfs", "-o", ",".join(options), "none", "disk"], check=True)


def _unmount():
    """Copy what is on the disk to where it was mounted, to be looked at."""
    shutil.copytree("disk", "copy", symlinks=True)
    subprocess.run(["umount", "--lazy", "disk"], check=True)
    os.rmdir("disk")
    os.rename("copy", "disk")


def _case(rng, good):
    good.take(
        "frame.png", "endoscope.json", "cal.json", "pictures", "sheet", "geometry.xml", "photometry.xml"
    )
    Path("disk").mkdir()
    words, writes = pick(rng, COMMANDS)
    kept = next((names for name, names in GROWING.items() if name in words), ())
    kept = tuple(f"disk/{name}" for name in kept)
    new = ("disk/new.json", "disk/new_report") if words[0] == "calibrate" else (f"disk/{writes}",)
    return command(*words, new=new, kept=kept, names=("disk", "temporary"), after=_unmount)


def full_disk(rng, good):
    """A command that writes on a disk which is full at once, or before all is written."""
    case = _case(rng, good)
    _mount(
        f"size={int(4 * 2 ** rng.uniform(0, 7))}k", "nr_inodes=100" if rng.random() < 0.8 else "nr_inodes=4"
    )
    return case


def read_only_disk(rng, good):
    """A command that writes on a disk which is read-only."""
    case = _case(rng, good)
    _mount("size=1m", "ro")
    return case.but(status=2)
