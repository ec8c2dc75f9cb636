"""Direct light out of a colour picture: what bounced is computed from the surface and removed.

A wall of albedo a shows I_c = g a/π (E + S), the lamp's light E and light S from other walls. The three
colours see one E, but the more a colour is reflected, the more of it bounces. From a surface that is known
roughly follows ι = S/E for each colour (`walls`, `colours`); divided by 1 + ι, the three pictures are three
measurements of E, which are merged and solved, and ι follows again from a better surface:

                 surface ----> ι of red, green, blue
                    ^                  |
                 solve <---- merge the three colours

    rounds: uncut, uncut, uncut | cut at ever less steep lines | the best of these, ι refined per pixel

Albedos that are not given are found from the colours: the tissue looks more alike all over the picture the
better the bounced light is known. At last the tint of each place tells where ι is still wrong.

This is the stage *remove indirect light*. With three colours it chooses the contours as well, and the next
stage then does nothing: where a fold hides a wall, a surface that goes on smoothly sends light to the wrong
places, so that light and cuts are found together.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from endolab.frames.frame import ROUNDING, SATURATED
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.resampling import resample
from endolab.numerics.side_by_side import by_rows, run_ahead
from endolab.reconstruction.channels import (
    Channel,
    Channels,
    Task,
    in_units,
    resample_surface,
    start_from,
)
from endolab.reconstruction.contours.choice import (
    CHOICE,
    CONTOURS,
    Trial,
    count_cuts,
    cut_at_contours,
    enlarge_cuts,
    min_steepness_of,
    solve_stage,
)
from endolab.reconstruction.contours.lines import find_contours
from endolab.reconstruction.light.colours import (
    FIT,
    AlbedoPrior,
    Light,
    NoColour,
    Patches,
    all_exact,
    fit_light,
    refine_per_pixel,
)
from endolab.reconstruction.light.walls import Walls
from endolab.solvers.gauss_newton import DESCENT
from endolab.solvers.problem import EXACT, NONE, Problem
from endolab.solvers.provenance import (
    ContourOutcome,
    ContourReport,
    LightOutcome,
    LightReport,
    Provenance,
    SearchedPicture,
)
from endolab.solvers.result import Iterate, Result

BOUNCED = "bounced light"  # stage


@dataclass(frozen=True)
class Rounds:
    """How many steps each solve takes, and what is taken before there is a surface.

    Chosen on the rendered and path-traced frames, of 290 and 320 px: two more steps of the first round and
    one more of each other uncut one change the mean error by less than .03 %.
    """

    uncut: tuple[int, ...] = (4, 2, 2)
    cut: int = 3  # of each trial
    # Of the last round, whose ι is refined per pixel. Earlier that would fit every trial to the colours, so
    # that they could tell the trials apart no more.
    refined: int = 1
    ratio_doubt: float = 0.15  # share of ι that may be wrong
    # Before indirect light is known, lines (jumps of log d₀) are less steep by this factor.
    guessed_steepness: float = 0.8
    # Median difference of stored values, as a share, up to which two colours are one.
    same_colour: float = 0.01


SEPARATION_ROUNDS = Rounds()


@dataclass(frozen=True)
class Separation:
    """What was found of a picture's indirect light."""

    indirect_ratio: (
        FloatArray  # (H, W, 3), ι in red, green and blue; 0 where nothing is known
    )
    light: Light
    surface: Iterate  # of the last problem that was solved, with the cuts that were chosen
    contours: ContourReport


# The stage ------------------------------------------------------------------------------


def remove_indirect_light(
    channels: Channels,
    albedo: FloatArray | None,
    contours: bool | None = None,
    before: Result | None = None,
) -> Generator[Iterate, None, Task]:
    """Find the light that has not bounced; every solve's iterates are yielded, stage and round named.

    `albedo` is what is known of the wall's: (3,), green's alone, or None. `contours` says whether to cut the
    surface at those that are found, by default if that explains the picture much better. `before`
    is an earlier result: of another frame, it makes one round enough; of this frame, it tells all.

    Returns the problem of direct light, or that of the clearest colour where colours tell nothing. One
    channel alone is returned as it is.
    """
    if not channels.are_colours:
        return _task_of(channels, 0, channels.light)
    known = None if before is None else _same_picture_as_before(channels, before, contours)
    if known is not None:
        return known
    try:
        if before is None:
            separation = yield from separate(channels.small, albedo, contours)
        else:
            separation = yield from _continue(channels, albedo, contours, before)
    except NoColour as error:
        # Of equals the first: green, blue, then red.
        clearest = max((1, 2, 0), key=lambda index: _signal(channels.full[index].problem))
        return _task_of(
            channels, clearest, LightReport(LightOutcome.NO_COLOUR, reason=str(error))
        )
    given = albedo is not None and albedo.ndim == 1
    return _in_full(channels, separation, given)


def _task_of(channels: Channels, index: int, light: LightReport | None) -> Task:
    """Take one channel as it is."""
    full = channels.full[index]
    provenance = Provenance(preparation=full.report, light=light)
    return Task(full.problem, channels.small[index].problem, provenance)


def _same_picture_as_before(
    channels: Channels, before: Result, contours: bool | None
) -> Task | None:
    """Return the task that an earlier result solves, if it is of the same picture; else None.

    Light and contours are known then, and only the energy may be another.
    """
    new = channels.middle
    old = before.provenance
    cuts = before.problem.cuts
    is_same = (
        before.status.is_done
        and old.preparation == new.report
        and old.light is not None
        and old.light.outcome is not LightOutcome.NO_COLOUR
        and old.contours is not None
        and old.contours.outcome is not ContourOutcome.GIVEN
        and new.problem.cuts is None
        and contours in (None, cuts is not None)
    )
    if not is_same:
        return None
    problem = replace(
        new.problem,
        image=before.problem.image,
        mask=before.problem.mask,
        evidence=before.problem.evidence,
        cuts=cuts,
    )
    problem = in_units(problem)
    provenance = Provenance(preparation=new.report, light=old.light, contours=old.contours)
    return Task(problem, problem, provenance, start_from(before.iterate, problem))


def _continue(
    channels: Channels, albedo: FloatArray | None, contours: bool | None, before: Result
) -> Generator[Iterate, None, Separation]:
    """Separate the picture from the surface of an earlier result, another frame's say."""
    surface = resample_surface(before.iterate, channels.small[1].problem)
    steepness = None if contours is False else min_steepness_of(before)
    # Another frame has other lines; those of the same one stay.
    is_same = np.array_equal(before.problem.shown, channels.middle.problem.shown)
    known = before.provenance.contours
    searched = known.searched if is_same and known is not None else None
    found = yield from separate_from(channels.small, albedo, surface, steepness, searched)
    if contours is not False:
        return found
    return replace(found, contours=ContourReport(ContourOutcome.NOT_ASKED))


def separate(
    channels: Sequence[Channel],
    albedo: FloatArray | None = None,
    contours: bool | None = None,
) -> Generator[Iterate, None, Separation]:
    """Find the indirect light of a picture, its surface, and where it is cut, in rounds.

    `channels` are red, green and blue of one picture; `albedo` is what is known of the wall's: (3,), green's
    alone, or nothing. Raises `NoColour` if the colours are one.
    """
    colours = [channel.problem for channel in channels]
    provenance = Provenance(preparation=channels[1].report)
    _check_colours(colours)
    prior = AlbedoPrior.of(albedo)
    nothing = np.zeros((*colours[1].mask.shape, 3))
    first = merge(colours, nothing, prior.albedo)
    few = SEPARATION_ROUNDS.uncut[0]
    surface = yield from solve_stage(first, provenance, BOUNCED, 1, max_iterations=few)
    trial = _LitTrial.of(surface, colours, prior)
    counts = SEPARATION_ROUNDS.uncut[1:]
    if trial.is_clean:  # there is nothing to ask the colours again
        counts = (sum(counts),)
    for number, count in enumerate(counts, 2):
        ratio = trial.indirect_ratio
        searched = SearchedPicture(ratio, trial.lit.albedo)
        surface = yield from solve_direct(
            colours, ratio, trial.lit, trial.surface, number, count
        )
        trial = trial.next(surface, colours, prior)
    report = ContourReport(ContourOutcome.NOT_ASKED)
    if contours is not False:
        trials = yield from _try_contours(colours, trial, prior, number)
        number += len(trials) - 1
        chosen, outcome = CHOICE.choose(trials, always=bool(contours))
        trial = trials[chosen]
        report = ContourReport(
            outcome, min_steepness=trial.min_steepness, searched=searched
        )
    surface = trial.surface
    ratio = trial.indirect_ratio
    light = trial.lit
    if light.outcome is LightOutcome.REMOVED:
        ratio = refine_per_pixel(colours, ratio, light)
        surface = yield from solve_direct(
            colours, ratio, light, surface, number + 1, SEPARATION_ROUNDS.refined
        )
        ratio, light = estimate_indirect(colours, surface, prior, per_pixel=True)
    return Separation(ratio, light, surface, report)


@dataclass(frozen=True, kw_only=True)
class _LitTrial(Trial):
    """A surface that is cut, or not, with its light."""

    indirect_ratio: FloatArray
    lit: Light

    @property
    def is_clean(self) -> bool:
        """Whether no light bounced: then energies alone tell which surface is right."""
        return self.light is LightOutcome.NONE_BOUNCED

    @classmethod
    def of(
        cls,
        surface: Iterate,
        colours: Sequence[Problem],
        prior: AlbedoPrior,
        min_steepness: float | None = None,
    ) -> _LitTrial:
        """Ask the colours of the light on a surface."""
        ratio, light = estimate_indirect(colours, surface, prior)
        return cls(
            surface,
            min_steepness,
            light.outcome,
            light.factor,
            light.misfit,
            indirect_ratio=ratio,
            lit=light,
        )

    def next(
        self,
        surface: Iterate,
        colours: Sequence[Problem],
        prior: AlbedoPrior,
        min_steepness: float | None = None,
    ) -> _LitTrial:
        """Do so of another surface of the same picture, if there is anything to ask."""
        if self.is_clean:
            return replace(self, surface=surface, min_steepness=min_steepness)
        return self.of(surface, colours, prior, min_steepness)


def _try_contours(
    colours: Sequence[Problem], uncut: _LitTrial, prior: AlbedoPrior, number: int
) -> Generator[Iterate, None, list[_LitTrial]]:
    """Cut the surface at ever less steep lines; return what is found each time, the uncut surface first.

    The three colours tell which of them is right: they agree less on the light that has not bounced the
    worse the surface is. The first two are solved side by side, each other one while the colours are asked
    of the one before. Where nothing bounced, each starts from the one before. `number` is the last round's.
    """
    trials = [uncut]
    surface = uncut.surface
    few = SEPARATION_ROUNDS.cut
    if uncut.is_clean:  # a trial is chosen by its energy, which must be near its end
        few = SEPARATION_ROUNDS.uncut[0]

    lines = find_contours(surface.problem.log_d0, surface.problem.mask)
    cut = [
        (min_steepness, cut_at_contours(surface.problem, min_steepness, lines))
        for min_steepness in CHOICE.min_steepness
    ]
    cut = [(steepness, problem) for steepness, problem in cut if problem.cuts is not None]

    def solve(index: int, start: Iterate) -> Generator[Iterate, None, Iterate]:
        return solve_stage(
            cut[index][1],
            surface.provenance,
            CONTOURS,
            number + 1 + index,
            start=start.log_distance,
            max_iterations=few,
        )

    with ExitStack() as ahead:

        def begin(
            index: int, start: Iterate
        ) -> Callable[[], Generator[Iterate, None, Iterate]]:
            return ahead.enter_context(run_ahead(solve(index, start)))

        # Where nobody asks the colours meanwhile, one after the other is as fast, and nearer its end.
        together = 1 if uncut.is_clean else 2
        begun = [begin(index, surface) for index in range(min(together, len(cut)))]
        for index, (min_steepness, _) in enumerate(cut):
            found = yield from begun[index]()
            if index + 1 == len(begun) < len(cut):
                begun.append(begin(index + 1, found))
            trials.append(uncut.next(found, colours, prior, min_steepness))
            if not CHOICE.goes_on(trials):
                break
    return trials


def separate_from(
    channels: Sequence[Channel],
    albedo: FloatArray | None,
    log_distance: FloatArray,
    min_steepness: float | None = None,
    searched: SearchedPicture | None = None,
) -> Generator[Iterate, None, Separation]:
    """Do the same with a surface that is nearly the right one, the last frame's say: one round.

    `log_distance` is its log d (H, W), nan where unknown, in the unit that the gain of `channels` gives. If
    there is a `min_steepness`, it is cut at this frame's lines that are steeper, or at those of the picture
    that was `searched`.
    """
    colours = [channel.problem for channel in channels]
    prior = AlbedoPrior.of(albedo)
    if searched is None:
        searched = SearchedPicture(
            np.zeros((*colours[1].mask.shape, 3)),
            prior.albedo,
            SEPARATION_ROUNDS.guessed_steepness,
        )
    problem = colours[1]
    outcome = ContourOutcome.NONE_CLEAR
    if min_steepness is not None:
        cuts = _find_cuts(colours, searched, min_steepness)
        problem = replace(problem, cuts=cuts)
        outcome = ContourOutcome.NONE_CLEAR if cuts is None else ContourOutcome.AS_BEFORE
    provenance = Provenance(preparation=channels[1].report)
    surface = Iterate(problem, 0, log_distance, {}, provenance=provenance)
    ratio, light = estimate_indirect(colours, surface, prior, per_pixel=True)
    count = SEPARATION_ROUNDS.uncut[-1]
    halvings = DESCENT.start_halvings  # the camera may have moved
    surface = yield from solve_direct(
        colours, ratio, light, surface, 1, count, halvings=halvings
    )
    report = ContourReport(outcome, min_steepness=min_steepness, searched=searched)
    return Separation(ratio, light, surface, report)


def estimate_indirect(
    colours: Sequence[Problem],
    surface: Iterate,
    prior: AlbedoPrior,
    per_pixel: bool = False,
) -> tuple[FloatArray, Light]:
    """Return ι (H, W, 3) of a surface, refined if `per_pixel`, and what the colours tell of its light."""
    if not all_exact(colours).any():
        raise NoColour("no pixel shows all three of them")
    green = colours[1]
    k = green.photometry.k
    v = surface.log_distance
    mask = np.any([colour.mask for colour in colours], axis=0) & np.isfinite(v)
    walls = Walls.of(v, mask, green.field, k, surface.problem.cuts)
    light = fit_light(Patches.of(colours, walls), prior)
    ratio = light.indirect_ratio(walls, k)
    return (refine_per_pixel(colours, ratio, light) if per_pixel else ratio), light


def solve_direct(
    colours: Sequence[Problem],
    indirect_ratio: FloatArray,
    light: Light,
    surface: Iterate,
    number: int,
    count: int,
    **options: Any,
) -> Generator[Iterate, None, Iterate]:
    """Solve again from a surface, without its indirect light: `count` steps at most, as round `number`."""
    problem = merge(colours, indirect_ratio, light.albedo)
    if surface.problem.cuts is not None:
        problem = replace(problem, cuts=surface.problem.cuts)
    v = surface.log_distance
    start = np.where(np.isfinite(v), v, problem.log_d0)
    provenance = surface.provenance
    options |= {"start": start, "max_iterations": count}
    return (yield from solve_stage(problem, provenance, BOUNCED, number, **options))


def _find_cuts(
    colours: Sequence[Problem], searched: SearchedPicture, min_steepness: float
) -> BoolArray | None:
    """Return cuts at the contours of the picture that is searched.

    It is the picture without the indirect light of the uncut surface. The ι of a cut one is so large at limbs
    and behind folds that it would make lines of its own there.
    """
    ratio = resample(searched.indirect_ratio, colours[1].mask.shape)
    picture = merge(colours, ratio, searched.albedo)
    return cut_at_contours(picture, searched.share * min_steepness).cuts


def _in_full(channels: Channels, separation: Separation, given: bool) -> Task:
    """Return the problem of the light that has not bounced, at full size; `given`: whether albedos were."""
    colours = [channel.problem for channel in channels.full]
    shape = colours[1].mask.shape
    light = separation.light
    problem = merge(colours, resample(separation.indirect_ratio, shape), light.albedo)
    report = separation.contours
    small = separation.surface.problem
    if small.cuts is not None:
        by_energy = report.outcome is ContourOutcome.BY_ENERGY
        if by_energy or small.mask.shape == shape:  # it chose these very lines
            problem = replace(problem, cuts=enlarge_cuts(small.cuts, shape))
        else:  # the colours chose how steep they must be
            searched = report.searched or SearchedPicture(
                separation.indirect_ratio, light.albedo
            )
            steepness = report.min_steepness or CHOICE.min_steepness[0]
            problem = replace(problem, cuts=_find_cuts(colours, searched, steepness))
    if problem.cuts is not None and report.outcome is ContourOutcome.NOT_ASKED:
        report = ContourReport(ContourOutcome.GIVEN)
    problem = in_units(problem)
    provenance = Provenance(
        preparation=channels.middle.report,
        light=_report_on(light, separation.indirect_ratio, given),
        contours=replace(report, steps=count_cuts(problem)),
    )
    return Task(problem, small, provenance, start_from(separation.surface, problem))


def _report_on(light: Light, indirect_ratio: FloatArray, given: bool) -> LightReport:
    """Sum up what was found of indirect light."""
    percent = [
        100 * float(np.median(s[s > 0])) if (s > 0).any() else 0.0 for s in indirect_ratio.T
    ]
    return LightReport(
        outcome=light.outcome,
        reason=light.reason,
        albedo=tuple(float(value) for value in light.albedo),
        given=given,
        percent=tuple(percent),
        factor=light.factor,
        lamp=light.lamp,
    )


# Colours --------------------------------------------------------------------------------


def merge(
    colours: Sequence[Problem], indirect_ratio: FloatArray, albedo: FloatArray
) -> Problem:
    """Merge red, green and blue of one picture into one problem of direct light, given ι (H, W, 3).

    It is green's, with the picture that direct light alone would have made. Each colour counts by its
    noise, its texture and what may be wrong with ι; what is saturated does not.
    """
    gamma = colours[1].photometry.gamma
    mask = np.any([colour.mask for colour in colours], axis=0)
    kinds = np.full((3, *mask.shape), EXACT, np.int8)
    for kind, colour in zip(kinds, colours, strict=True):
        if colour.evidence is not None:
            kind[:] = colour.evidence
        kind[~colour.mask] = NONE
    evidence = kinds.min(axis=0)  # EXACT before LOWER_BOUND before NONE
    noises = [_noise(colour) for colour in colours]
    image = np.empty(mask.shape)

    def merge_rows(rows: slice) -> None:
        total = np.zeros(mask[rows].shape)
        weights = np.zeros(mask[rows].shape)
        for c, colour in enumerate(colours):
            ratio = indirect_ratio[rows, :, c]
            counts = colour.mask[rows] & (kinds[c, rows] == evidence[rows])
            shade = np.maximum(colour.image[rows], noises[c])
            by_noise = (gamma * noises[c] / shade) ** 2
            by_ratio = (SEPARATION_ROUNDS.ratio_doubt * ratio / (1 + ratio)) ** 2
            weight = np.where(counts, 1 / (by_noise + by_ratio + FIT.texture[c] ** 2), 0.0)
            log_direct = (
                gamma * np.log(shade) - np.log1p(ratio) + np.log(albedo[1] / albedo[c])
            )
            total += weight * log_direct
            weights += weight
        mean = total / np.where(mask[rows], weights, 1.0)
        light = np.where(mask[rows], np.exp(mean), 0.0)
        image[rows] = light ** (1 / gamma)

    by_rows(merge_rows, mask.shape)
    evidence[~mask] = EXACT
    return replace(
        colours[1], image=image, mask=mask, evidence=evidence if evidence.any() else None
    )


def _noise(problem: Problem) -> float:
    """Return the noise of a channel, that of rounding at least."""
    return max(problem.noise, ROUNDING)


def _signal(problem: Problem) -> float:
    """Return median grey level over noise; less where much is saturated."""
    image = problem.image[problem.mask]
    share = np.mean(image < SATURATED)
    return float(np.median(image) * share) / _noise(problem)


def _check_colours(colours: Sequence[Problem]) -> None:
    """Raise NoColour if the three are one picture, such as a grey one that was stored as RGB."""
    mask = np.all([colour.mask for colour in colours], axis=0)
    if not mask.any():
        return
    red, green, blue = (colour.image[mask] for colour in colours)
    differences = [np.median(np.abs(other / green - 1)) for other in (red, blue)]
    if max(differences) < SEPARATION_ROUNDS.same_colour:
        raise NoColour("red, green and blue are one")
