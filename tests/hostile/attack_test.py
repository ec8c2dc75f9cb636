"""Some cases of each class, always the same; `make attack` runs many more."""

import sys

import pytest

from tests.hostile import disks
from tests.hostile.classes import CLASSES, MOUNTING, SHARES
from tests.hostile.guard import Guard, told

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="it looks into /proc")
CASES = 16  # of each class, times its share

# Seeds that are not survived yet, by class, with the reason: to be empty.
OPEN: dict[str, dict[int, str]] = {}


@pytest.fixture(scope="module")
def guard():
    with Guard(limit=60) as watched:
        yield watched


@pytest.fixture(scope="module")
def mounting():
    """A guard whose worker may mount disks."""
    if not disks.allowed():
        pytest.skip("no disk can be mounted here: `unshare --mount --map-root-user` is not allowed")
    with Guard(limit=60, prefix=disks.PREFIX) as watched:
        yield watched


def check(outcomes):
    failed = [outcome for outcome in outcomes if outcome.wrong]
    known = OPEN.get(outcomes[0].name, {})
    assert not [outcome for outcome in failed if outcome.seed not in known], "\n" + "\n".join(
        told([outcome for outcome in failed if outcome.seed not in known])
    )
    mended = set(known) - {outcome.seed for outcome in failed}
    assert not mended, f"survived by now, so no longer open: {sorted(mended)}"


def test_a_case_follows_from_its_class_and_seed(guard):
    assert set(SHARES) == set(CLASSES)
    first, again = (guard.run_all("image", range(5)) for _ in range(2))
    assert [(one.told, one.status, one.said) for one in first] == [
        (one.told, one.status, one.said) for one in again
    ]


@pytest.mark.parametrize("name", [name for name in CLASSES if name not in MOUNTING])
def test_every_case_is_survived(guard, name):
    check(guard.run_all(name, range(CASES * SHARES[name])))


@pytest.mark.parametrize("name", sorted(MOUNTING))
def test_every_disk_is_survived(mounting, name):
    check(mounting.run_all(name, range(8)))
