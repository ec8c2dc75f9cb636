"""Single-view depth: the energy and the solvers."""
