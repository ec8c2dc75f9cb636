"""The examples in the docstrings of what `endolab` offers give what they say."""

import doctest

import pytest

import endolab as el
from endolab import metrics

FINDER = doctest.DocTestFinder(recurse=False)
OFFERED = [
    thing
    for module in (el, metrics)
    for name in module.__all__
    if callable(thing := getattr(module, name))
]
EXAMPLES = {
    test.name: test
    for thing in OFFERED
    for test in FINDER.find(thing, globs={})
    if test.examples
}


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_gives_what_it_says(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    runner = doctest.DocTestRunner(verbose=False)
    runner.run(EXAMPLES[name])
    assert runner.summarize(verbose=False).failed == 0
