"""Every option stands once: what is derived from `Settings` follows when one more is added."""

import inspect

import pytest

import endolab as el
from endolab.model.surface import XI
from endolab.reconstruction import settings
from endolab.solvers.problem import REGULARISERS
from endolab.solvers.solvers import SOLVERS


def test_choices_are_those_that_there_are():
    choices = {
        part.name: settings.option_of(part.name).choices
        for part in settings.option_fields()
    }
    assert choices["solver"] == tuple(sorted(SOLVERS))
    assert choices["xi"] == XI
    assert choices["regulariser"] == ("auto", *REGULARISERS)


@pytest.mark.parametrize("name", [part.name for part in settings.option_fields()])
def test_keywords_of_reconstruct_are_the_options(name):
    assert name in inspect.signature(el.reconstruct).parameters
    assert f"    {name} : " in el.reconstruct.__doc__
