"""Every option stands once: what is derived from `Settings` follows when one more is added."""

import argparse
import inspect
from dataclasses import dataclass

import pytest

import endolab as el
from endolab.cli.options import add_solving_options
from endolab.io.settings import read_settings
from endolab.model.ranges import RANGES
from endolab.model.surface import XI
from endolab.reconstruction import settings
from endolab.solvers.problem import REGULARISERS
from endolab.solvers.solvers import SOLVERS
from endolab.workbench.tuning.controls import knob_specs


@pytest.fixture
def one_more(monkeypatch):
    """Settings with the option `speckle`, in place of those that there are."""

    @dataclass(frozen=True)
    class Settings(settings.Settings):
        speckle: float = settings.option(
            0.5, "grains of the light", settings.NUMBER, form="G"
        )

    monkeypatch.setattr(settings, "Settings", Settings)
    monkeypatch.setattr("endolab.io.settings.Settings", Settings)
    monkeypatch.setitem(RANGES, "speckle", (0.0, 1.0))
    return Settings


def test_an_option_is_one_field_that_is_seen_everywhere(one_more, tmp_path):
    @settings.takes_settings
    def solve(frame, **options):
        """Solve.

        Parameters
        ----------
        **options
            Others.
        """

    assert inspect.signature(solve).parameters["speckle"].default == 0.5
    assert "speckle : " in solve.__doc__
    parser = argparse.ArgumentParser()
    add_solving_options(parser, parser.add_argument)
    assert parser.parse_args(["--calibration", "c", "--speckle", "0.7"]).speckle == 0.7
    (tmp_path / "s.json").write_text('{"endolab_settings": 1, "speckle": 0.7}')
    assert read_settings(tmp_path / "s.json").keywords == {"speckle": 0.7}
    assert "speckle" in {spec["name"] for spec in knob_specs()}
    assert one_more.of({"speckle": 0.7}).as_dict()["speckle"] == 0.7
    with pytest.raises(ValueError, match="speckle"):
        one_more(speckle=2.0)


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
