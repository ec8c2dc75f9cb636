"""The long attack: every class, from a seed on, and a table of what was survived.

``python -m tests.hostile.attack`` runs all; ``--only image --seed 17`` one case, whose folder it keeps;
``--package FOLDER`` attacks another checkout.
"""

import argparse
import time
from pathlib import Path

from tests.hostile import guard
from tests.hostile.classes import CLASSES, SHARES

WIDEST = max(map(len, CLASSES))


def share(name, cases):
    """How many of all the cases are of a class."""
    return max(1, round(cases * SHARES[name] / sum(SHARES.values())))


def attack(names, cases, first, minutes, package, told):
    """Run cases of these classes and print a line for each; whether all were survived."""
    print(f"{'class':{WIDEST}}  tried  survived  accepted  seconds  worst s  peak MB", flush=True)
    tried, survived, end = 0, 0, time.monotonic() + 60 * minutes
    with guard.Guard(package=package) as watched:
        for number, name in enumerate(names):
            rest = (end - time.monotonic()) / (len(names) - number)
            until, started, outcomes = time.monotonic() + rest, time.monotonic(), []
            for seed in range(first, first + share(name, cases)):
                outcomes.append(watched.run(name, seed))
                if time.monotonic() > until:
                    break
            good = sum(not outcome.wrong for outcome in outcomes)
            tried, survived = tried + len(outcomes), survived + good
            counts = f"{len(outcomes):5}  {good:8}  {sum(outcome.status == 0 for outcome in outcomes):8}"
            worst, peak = max(o.seconds for o in outcomes), max(o.peak for o in outcomes)
            print(
                f"{name:{WIDEST}}  {counts}  {time.monotonic() - started:7.0f}  {worst:7.2f}  {peak:7.0f}",
                flush=True,
            )
            with open(told, "a", encoding="utf-8", errors="backslashreplace") as stream:
                stream.writelines(f"{sentence}\n" for sentence in guard.told(outcomes))
    print(f"{'all':{WIDEST}}  {tried:5}  {survived:8}")
    return tried == survived


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=24_000, help="of all classes together")
    parser.add_argument(
        "--seed", type=int, default=1000, help="of each class's first case; the tests begin at 0"
    )
    parser.add_argument("--minutes", type=float, default=30, help="at most")
    parser.add_argument(
        "--only", action="append", choices=list(CLASSES), metavar="CLASS", help=", ".join(CLASSES)
    )
    parser.add_argument("--package", type=Path, help="the folder of another checkout")
    parser.add_argument(
        "--told", type=Path, default=Path("build/attack.txt"), help="what was not survived (%(default)s)"
    )
    given = parser.parse_args()
    if given.only and len(given.only) == 1 and given.cases == parser.get_default("cases"):
        with guard.Guard(package=given.package, keep=True, limit=600) as watched:
            outcome = watched.run(given.only[0], given.seed)
        print(
            f"{outcome}\n    {outcome.seconds:.2f} s, {outcome.peak:.0f} MB; its folder is below {watched.place}"
        )
        return bool(outcome.wrong)
    given.told.parent.mkdir(parents=True, exist_ok=True)
    given.told.write_text("")
    good = attack(
        given.only or list(CLASSES), given.cases, given.seed, given.minutes, given.package, given.told
    )
    print(f"what was not survived: {given.told}")
    return not good


if __name__ == "__main__":
    raise SystemExit(main())
