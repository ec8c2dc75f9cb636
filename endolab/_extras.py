"""Packages that are missing, or too old: each is said in a sentence, and nothing is loaded for it."""

import re
from importlib.util import find_spec
from pathlib import Path


class MissingPackage(ImportError):
    """A package of an extra is not installed."""


def lacking(*packages: str) -> str:
    """Say which of these packages is missing and what brings it; empty if none is. Nothing is loaded."""
    missing = next((package for package in packages if find_spec(package) is None), None)
    if missing is None:
        return ""
    extra = "dicom" if missing == "pydicom" else "lab"
    return f'{missing} is not installed; pip install "endolab[{extra}]" brings it'


def need(*packages: str) -> None:
    """Raise `MissingPackage`, in one sentence, unless all of these packages are installed."""
    sentence = lacking(*packages)
    if sentence:
        raise MissingPackage(sentence)


def check_opencv() -> None:
    """Raise ImportError, in one sentence, if another OpenCV package has put an older version in place.

    The four packages of OpenCV write into one folder, `cv2`, and the last that was installed is imported.
    """
    package = find_spec("cv2")
    if package is None or package.origin is None:
        return
    stated = Path(package.origin).with_name("version.py")
    if not stated.is_file():
        return
    version = re.search(r"(\d+)[\d.]+", stated.read_text(encoding="utf-8"))
    if version is not None and int(version[1]) < 5:
        packages = "opencv-python opencv-contrib-python opencv-python-headless"
        remedy = f"pip uninstall {packages}, then install endolab"
        where = f"{version[0]} in {stated.parent}"
        raise ImportError(f"endolab needs OpenCV 5, found {where}: {remedy}")
