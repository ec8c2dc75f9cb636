"""An attack on endolab: thousands of damaged files, odd calls, kills and full disks, each from a seed.

- `damage`: how bytes, JSON, tables, pictures and archives are damaged.
- `given`: the good files that are damaged.
- `damaged_files`, `odd_calls`, `disks`: the classes of cases. One function a class, from a random generator
  to a `Case`: what is run, what may be new afterwards, what a refusal must name.
- `judge`: what must hold afterwards: exit 0 or 2, one sentence, whole or nothing, and nothing left behind.
- `worker` runs cases one after another in a process that is warm; `guard` watches it from outside.
- `kills`: commands that are killed while they solve, and then run again.
- `attack`: all of it, from the command line.

A case is its class and its seed: ``python -m tests.hostile.attack --only image --seed 17`` runs that
one, says what it ran, and keeps its folder.
"""
