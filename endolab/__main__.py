"""python -m endolab."""

from endolab.cli.main import run

run()
