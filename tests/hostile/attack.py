"""The long attack: every class, from a seed on, and a table of what was survived.

``python -m tests.hostile.attack`` runs all; ``--only image --seed 17`` one case, whose folder it keeps;
``--only "kill video" --cases 20`` twenty kills; ``--package FOLDER`` attacks another checkout.
"""

import argparse
import sys
import time
from contextlib import ExitStack
from pathlib import Path

from tests.hostile import disks, guard
from tests.hostile.classes import MOUNTING, SHARES
from tests.hostile.kills import COMMANDS, Kills

KILLS = {f"kill {name}": 0.4 for name in COMMANDS}  # with their share of an attack: each takes seconds
NAMES = {**SHARES, **KILLS}
WIDEST = max(map(len, NAMES))


class Attack:
    """Runs a case of any class: in a worker, in one that may mount disks, or in a fork that is killed."""

    def __init__(self, package, keep, limit=guard.LIMIT):
        self.package, self.how = package, {"package": package, "keep": keep}
        self.limit, self.stack, self.runners = limit, ExitStack(), {}

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.stack.close()

    def runner(self, name):
        """The one that runs cases of a class, ready to; None where it cannot be had."""
        kind = "kills" if name in KILLS else "disks" if name in MOUNTING else "worker"
        if kind not in self.runners:
            if kind == "kills":
                made = self.stack.enter_context(Kills(**self.how))
            elif kind == "disks" and not disks.allowed():
                made = None
            else:
                prefix = disks.PREFIX if kind == "disks" else ()
                made = self.stack.enter_context(guard.Guard(**self.how, limit=self.limit, prefix=prefix))
                made.start()
            self.runners[kind] = made
        return self.runners[kind]

    def run(self, name, seed):
        """Run a case."""
        runner = self.runner(name)
        return runner.kill(name.removeprefix("kill "), seed) if name in KILLS else runner.run(name, seed)


def attack(names, cases, first, minutes, package, told):
    """Run cases of these classes and print a line for each; whether all were survived."""
    print(f"{'class':{WIDEST}}  tried  survived  accepted  seconds  worst s  peak MB", flush=True)
    tried, survived, end, whole = 0, 0, time.monotonic() + 60 * minutes, sum(NAMES[name] for name in names)
    with Attack(package, keep=False) as there:
        for number, name in enumerate(names):
            if there.runner(name) is None:
                print(f"{name:{WIDEST}}  no disk can be mounted here")
                continue
            started, outcomes = time.monotonic(), []
            until = started + (end - started) / (len(names) - number)
            for seed in range(first, first + max(1, round(cases * NAMES[name] / whole))):
                outcomes.append(there.run(name, seed))
                if time.monotonic() > until:
                    break
            good = sum(not outcome.wrong for outcome in outcomes)
            tried, survived = tried + len(outcomes), survived + good
            counts = f"{len(outcomes):5}  {good:8}  {sum(outcome.status == 0 for outcome in outcomes):8}"
            worst, peak = max(o.seconds for o in outcomes), max(o.peak for o in outcomes)
            took = f"{time.monotonic() - started:7.0f}  {worst:7.2f}  {peak:7.0f}"
            print(f"{name:{WIDEST}}  {counts}  {took}", flush=True)
            with told.open("a", encoding="utf-8", errors="backslashreplace") as stream:
                stream.writelines(f"{sentence}\n" for sentence in guard.told(outcomes))
    print(f"{'all':{WIDEST}}  {tried:5}  {survived:8}")
    return tried == survived


def main():
    """Attack as the command line says; 1 if something was not survived."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    option = parser.add_argument
    option("--cases", type=int, default=24_000, help="of all classes together (default %(default)s)")
    how = "of each class's first case (default 1000; the tests begin at 0); with --only, the one case"
    option("--seed", type=int, help=how)
    option("--minutes", type=float, default=30, help="at most (default %(default)s)")
    option("--only", action="append", choices=list(NAMES), metavar="CLASS", help=", ".join(NAMES))
    option("--package", type=Path, help="the folder of another checkout")
    where = "where to say what was not survived (default %(default)s)"
    option("--told", type=Path, default=Path("build/attack.txt"), help=where)
    given = parser.parse_args()
    sys.stdout.reconfigure(errors="backslashreplace")
    if given.only and given.cases == parser.get_default("cases"):
        with Attack(given.package, keep=True, limit=600) as there:
            outcome = there.run(given.only[0], given.seed or 0)
            print(f"{outcome}\n{outcome.seconds:.2f} s, {outcome.peak:.0f} MB")
            print(f"its folder is below {there.runner(given.only[0]).place}")
        return bool(outcome.wrong)
    given.told.parent.mkdir(parents=True, exist_ok=True)
    given.told.write_text("")
    first = 1000 if given.seed is None else given.seed
    good = attack(given.only or list(NAMES), given.cases, first, given.minutes, given.package, given.told)
    print(f"what was not survived: {given.told}")
    return not good


if __name__ == "__main__":
    raise SystemExit(main())
