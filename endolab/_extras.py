"""The packages of the extra `lab`, which the core does without: what is missing is said in a sentence."""

from importlib.util import find_spec


class MissingPackage(ImportError):
    """A package of an extra is not installed."""


def lacking(*packages: str) -> str:
    """Say which of these packages is missing and what brings it; empty if none is. Nothing is loaded."""
    missing = next((package for package in packages if find_spec(package) is None), None)
    return "" if missing is None else f'{missing} is not installed; pip install "endolab[lab]" brings it'


def need(*packages: str) -> None:
    """Raise `MissingPackage`, in one sentence, unless all of these packages are installed."""
    sentence = lacking(*packages)
    if sentence:
        raise MissingPackage(sentence)
