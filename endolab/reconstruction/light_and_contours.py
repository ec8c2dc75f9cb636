"""Direct light out of a colour picture, and the surface cut where folds hide walls: one stage.

A wall of albedo a shows I_c = g a/π (E + S), the lamp's light E and light S from other walls. The three
colours see one E, but the more a colour is reflected, the more of it bounces. From a surface that is known
roughly follows ι = S/E for each colour (`walls`, `colours`); divided by 1 + ι, the three pictures are three
measurements of E, which are merged and solved, and ι follows again from a better surface:

                 surface ----> ι of red, green, blue
                    ^                  |
                 solve <---- merge the three colours

A contour that is really there lets the picture be explained by a much smoother surface, and sends light to
the right places. The steeper a line of a picture (`lines`), the more likely it is a contour: nine of ten that
are steeper than .07 are in traced colons, six to eight of ten that are steeper than .035; among polyps these
are two or three of ten. So a surface is solved uncut, in rounds, and then cut at ever less steep lines:

    round, round, round --+--> cut at lines > .07
                          +--> cut at lines > .035 --> cut at lines > .018        which of these four?

`choose` answers. Where three colours see one wall, the right surface is the one on whose light they agree
best; of one channel, or where nothing bounced, the energy tells. At last the tint of each place tells where ι
of that surface is still wrong. Albedos that are not given are found from the colours: the tissue looks more
alike all over the picture the better the bounced light is known.

A cut surface begins as the uncut one: what lies behind an open line comes loose only as far as the energy
wants. A start on the far side would not do: regions that are held by little stay as far as they are put.

Living tissue has many tints, and the colours tell nothing. There all lines are cut that are steep in
red itself, and the surface begins anew: the uncut one explains by slopes what a fold hides.

All is solved on few pixels (`problem_of_frame.problems_of_frame`); the frame's own follow at the end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from endolab.frames.frame import ROUNDING
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.resampling import resample, resample_cuts
from endolab.numerics.side_by_side import run_together
from endolab.reconstruction import constants
from endolab.reconstruction.colours import (
    AlbedoPrior,
    Light,
    NoColour,
    Patches,
    fit_light,
    refine_per_pixel,
)
from endolab.reconstruction.lamps import Lamps, divide_by_lamps
from endolab.reconstruction.lines import find_contours
from endolab.reconstruction.settings import SEPARATED
from endolab.reconstruction.walls import Walls
from endolab.solvers.gauss_newton import gauss_newton
from endolab.solvers.linearised import far_end_moves
from endolab.solvers.problem import EXACT, LOWER_BOUND, NONE, Problem
from endolab.solvers.provenance import ContourOutcome, LightOutcome
from endolab.solvers.result import Iterate, Result, Solving, name_stage

# Stages
SMOOTH = "smooth"  # one channel, before anything is cut
BOUNCED = "bounced light"  # three colours, likewise
CONTOURS = "contours"  # cut

NO_LIGHT = Light(LightOutcome.NO_COLOUR, np.empty(0), 0.0, 0.0)  # of one channel


@dataclass(frozen=True, eq=False)
class Trial:
    """A surface that is cut, or not, with the light that its colours tell."""

    surface: Iterate
    light: Light = NO_LIGHT
    indirect_ratio: FloatArray = field(default_factory=lambda: np.empty(0))  # ι, (H, W, 3)
    min_steepness: float | None = None  # of the lines that are cut; None: uncut

    @property
    def is_direct(self) -> bool:
        """Whether the colours show no light that bounced."""
        return self.light.outcome is LightOutcome.NONE_BOUNCED

    @property
    def cut_length(self) -> float:
        """How long its cuts are, in heights of the picture."""
        cuts = self.surface.problem.cuts
        mask = self.surface.mask
        return 0.0 if cuts is None else float(cuts.sum()) * max(mask.shape) / mask.sum()


@dataclass(frozen=True, eq=False)
class Lines:
    """What is cut: links, if they are known; else lines of a picture that are steep."""

    cuts: BoolArray | None
    # The picture is the one without this ι, (h, w, 3), under these albedos, (3,).
    indirect_ratio: FloatArray
    albedo: FloatArray
    min_steepness: float | None

    def cuts_of(self, colours: Sequence[Problem]) -> BoolArray | None:
        """Return the cuts of red, green and blue, on however many pixels."""
        shape = colours[1].mask.shape
        if self.cuts is not None:
            return resample_cuts(self.cuts, shape)
        picture = merge(colours, resample(self.indirect_ratio, shape), self.albedo)
        return cut_at_contours(picture, self.min_steepness).cuts


@dataclass(frozen=True, eq=False)
class Separation:
    """What the stage found on few pixels, and what tells how the picture is cut on all."""

    trial: Trial  # the surface that was chosen, with its light
    contours: ContourOutcome
    lines: Lines
    lamp_ratio: FloatArray | None  # ω, (h, w)
    other_cut: tuple[float | None, float] | None = None  # see `Report`


def light_and_contours(
    small: Problem,
    full: Problem,
    prior: AlbedoPrior,
    contours: bool | None = None,
    before: Result | None = None,
    lamps: Lamps | None = None,
) -> Solving[tuple[Problem, FloatArray | None]]:
    """Take indirect light out of a picture, and cut its surface at contours; yield every solve's iterates.

    `small` is the frame on few pixels, `full` on all. `prior` is what is known of the wall's albedo.
    `contours` says whether to cut the surface, by default if that explains the picture much better. `before`
    is an earlier result, of another frame say: it makes one round enough, and what it cut is cut without
    asking. `lamps` are those that do not stand at the optical centre.

    Returns the problem of direct light on all pixels, or that of green where colours tell
    nothing; and a log d (H, W) to begin with, if there is one.
    """
    report: dict[str, Any] = {}
    if small.colours:
        try:
            if before is None:
                found = yield from separate(small, prior, contours, lamps)
            else:
                found = yield from _separate_as_before(
                    small, full, prior, contours, before, lamps
                )
            return _on_all_pixels(found, full, prior)
        except NoColour as error:
            report = {"light": LightOutcome.NO_COLOUR, "reason": str(error)}
    # Green, or what there is.
    full = replace(full, colours=(), report=replace(full.report, **report))
    if lamps is not None:
        start = None if before is None else before.iterate.start_of(small)
        small = replace(small, colours=())
        small, _ = yield from settle_lamps(small, start, lamps, constants.LAMP_ROUNDS)
        full = divide_by_lamps(full, small.lamp_ratio)

    # Its surface is cut where contours are found in its picture, before it is solved.
    steepness = first = None
    if full.cuts is not None:
        outcome = ContourOutcome.GIVEN
    elif contours is False:
        outcome = ContourOutcome.NOT_ASKED
    elif before is not None:
        steepness = min_steepness_of(before)
        full = cut_at_contours(full, steepness)
        is_cut = full.cuts is not None
        outcome = ContourOutcome.AS_BEFORE if is_cut else ContourOutcome.NONE_CLEAR
    else:
        uncut = yield from solve_stage(small, SMOOTH)
        trials = yield from _try_contours(Trial(uncut), (), None)
        chosen, outcome = choose(trials, always=bool(contours))
        steepness = chosen.min_steepness
        if steepness is not None:
            full = cut_at_contours(full, steepness)
            first = chosen.surface.start_of(full)
    return _with_contours(full, outcome, steepness), first


def _with_contours(
    problem: Problem, outcome: ContourOutcome, min_steepness: float | None
) -> Problem:
    cut_links = 0 if problem.cuts is None else int(problem.cuts.sum())
    report = replace(
        problem.report,
        contours=outcome,
        cut_links=cut_links,
        min_steepness=min_steepness if cut_links else None,
    )
    return replace(problem, report=report)


# Three colours --------------------------------------------------------------------------


def separate(
    problem: Problem,
    prior: AlbedoPrior,
    contours: bool | None = None,
    lamps: Lamps | None = None,
) -> Solving[Separation]:
    """Find the indirect light of a picture of three colours, its surface, and where it is cut, in rounds."""
    # Uncut: solve without the indirect light that is known so far, and ask the colours again.
    ratio = np.zeros((*problem.mask.shape, 3))
    light = prior.light
    surface = None
    rounds = constants.UNCUT_ROUNDS if lamps is None else constants.LAMP_ROUNDS
    for number, count in enumerate(rounds, 1):
        direct_picture = (ratio, light.albedo)  # the picture of which lines may be cut
        surface = yield from _solve_direct(problem, light, ratio, surface, number, count)
        problem = _lit_by_lamps(problem, lamps, surface)
        # Where lamps stand aside, the first two surfaces are too wrong to ask colours of.
        is_asked = light.outcome is not LightOutcome.NONE_BOUNCED
        if lamps is not None:
            is_asked = number > 2
        if is_asked:
            ratio, light = estimate_indirect(problem.colours, surface, prior)
    assert surface is not None
    trial = Trial(surface, light, ratio)

    # Cut at ever less steep lines.
    outcome = ContourOutcome.NOT_ASKED
    cuts = other_cut = None
    if contours is not False and light.outcome is LightOutcome.COMPUTED:
        outcome = ContourOutcome.NONE_CLEAR
        cuts = tissue_cuts(problem.colours)
        if cuts is not None:
            outcome = ContourOutcome.BY_LINES
            trial = replace(trial, min_steepness=constants.TISSUE_STEEPNESS)
    elif contours is not False:
        trials = yield from _try_contours(trial, problem.colours, prior, number + 1)
        number += len(trials) - 1
        trial, outcome = choose(trials, always=bool(contours))
        for doubt in (1 / 1.03, 1.03):  # a misfit may be another by so much
            other, _ = choose(trials, bool(contours), doubt)
            if other is not trial:
                moved = other.surface.log_distance - trial.surface.log_distance
                far_end = far_end_moves(trial.surface, moved)
                other_cut = (other.min_steepness, far_end)
    # Lines that the energy chose, and those of tissue, are cut themselves on all pixels; where colours chose,
    # those are that are as steep. They are of the uncut surface's picture: the ι of a cut one is so large at
    # limbs and behind folds that it would make lines of its own there.
    if outcome is ContourOutcome.BY_ENERGY:
        cuts = trial.surface.problem.cuts
    steepness = trial.min_steepness

    # The best of these, one step, ι refined per pixel: earlier that would fit every trial to the colours, so
    # that they could tell the trials apart no more.
    problem = _lit_by_lamps(problem, lamps, trial.surface)
    if trial.light.outcome is LightOutcome.REMOVED:
        ratio = refine_per_pixel(problem.colours, trial.indirect_ratio, trial.light)
        surface = yield from _solve_direct(
            problem, trial.light, ratio, trial.surface, number + 1, 1
        )
        ratio, light = estimate_indirect(problem.colours, surface, prior, per_pixel=True)
        trial = Trial(surface, light, ratio, steepness)
    lines = Lines(cuts, *direct_picture, steepness)
    return Separation(trial, outcome, lines, problem.lamp_ratio, other_cut)


def _lit_by_lamps(problem: Problem, lamps: Lamps | None, surface: Iterate) -> Problem:
    """Return the picture as one lamp at the optical centre would have lit it, by a surface."""
    return problem if lamps is None else divide_by_lamps(problem, lamps.ratio(surface))


def settle_lamps(
    problem: Problem,
    start: FloatArray | None,
    lamps: Lamps,
    rounds: Sequence[int],
) -> Solving[tuple[Problem, FloatArray]]:
    """Solve, so many steps a round, and divide by ω after each; return the last surface, too."""
    for number, count in enumerate(rounds, 1):
        surface = yield from solve_stage(
            problem, "lamps", number, start=start, max_iterations=count
        )
        problem = divide_by_lamps(problem, lamps.ratio(surface))
        start = surface.log_distance
    return problem, surface.log_distance


def separate_from(
    problem: Problem,
    prior: AlbedoPrior,
    log_distance: FloatArray,
    lamps: Lamps | None = None,
) -> Solving[Trial]:
    """Do the same with a surface that is nearly the right one, the last frame's say: one round.

    `log_distance` is its log d (H, W), nan where unknown, in the unit that the problem's gain gives.
    """
    surface = Iterate(problem, 0, log_distance)
    problem = _lit_by_lamps(problem, lamps, surface)
    ratio, light = estimate_indirect(problem.colours, surface, prior, per_pixel=True)
    count = constants.UNCUT_ROUNDS[-1]
    surface = yield from _solve_direct(
        problem,
        light,
        ratio,
        surface,
        1,
        count,
        halvings=2,  # the camera may have moved
    )
    return Trial(surface, light, ratio)


def _separate_as_before(
    small: Problem,
    full: Problem,
    prior: AlbedoPrior,
    contours: bool | None,
    before: Result,
    lamps: Lamps | None = None,
) -> Solving[Separation]:
    """Separate the picture from the surface of an earlier result, another frame's say."""
    steepness = None if contours is False else min_steepness_of(before)
    is_same = np.array_equal(before.problem.shown, full.shown)
    cuts = before.problem.cuts if is_same else None  # another frame has other lines
    if steepness == constants.TISSUE_STEEPNESS and not is_same:
        cuts = tissue_cuts(small.colours)
        steepness = None if cuts is None else steepness
    lines = Lines(cuts, np.zeros((1, 1, 3)), prior.albedo, 0.8 * (steepness or 0.0))
    outcome = ContourOutcome.NONE_CLEAR
    if contours is False:
        outcome = ContourOutcome.NOT_ASKED
    elif steepness is not None:
        small = replace(small, cuts=lines.cuts_of(small.colours))
        if small.cuts is not None:
            outcome = ContourOutcome.AS_BEFORE
    surface = before.iterate.resample(small)
    trial = yield from separate_from(small, prior, surface, lamps)
    trial = replace(trial, min_steepness=steepness)
    return Separation(trial, outcome, lines, trial.surface.problem.lamp_ratio)


def problem_as_before(
    full: Problem, before: Result, contours: bool | None
) -> Problem | None:
    """Return the problem that an earlier result solves, if it is of the same picture in colours; else None.

    Light and contours are known then, and only the energy may be another.
    """
    solved = before.problem
    old = solved.report
    is_same = (
        bool(full.colours)
        and old.fingerprint == full.report.fingerprint
        and (old.smooth, old.highlights) == (full.report.smooth, full.report.highlights)
        and solved.camera == full.camera
        and solved.is_lit_as(full)
        and old.lamps == full.report.lamps
        and old.channel == SEPARATED
        and old.contours is not ContourOutcome.GIVEN
        and full.cuts is None
        and contours in (None, solved.cuts is not None)
    )
    if not is_same:
        return None
    return replace(
        full,
        image=solved.image,
        mask=solved.mask,
        evidence=solved.evidence,
        cuts=solved.cuts,
        lamp_ratio=solved.lamp_ratio,
        colours=(),
        report=replace(old, scale="", length=None, length_by_gain=None),
    ).in_units()


def _on_all_pixels(
    found: Separation, full: Problem, prior: AlbedoPrior
) -> tuple[Problem, FloatArray | None]:
    """Return the problem of the light that has not bounced, and a start, if there is one."""
    trial = found.trial
    light = trial.light
    full = divide_by_lamps(full, found.lamp_ratio)
    ratio = resample(trial.indirect_ratio, full.mask.shape)
    problem = merge(full.colours, ratio, light.albedo, not light.reason)
    if trial.surface.problem.cuts is not None or found.contours is ContourOutcome.BY_LINES:
        problem = replace(problem, cuts=found.lines.cuts_of(full.colours))
    outcome = found.contours
    if problem.cuts is not None and outcome is ContourOutcome.NOT_ASKED:
        outcome = ContourOutcome.GIVEN
    percent = [
        100 * float(np.median(s[s > 0])) if (s > 0).any() else 0.0
        for s in trial.indirect_ratio.T
    ]
    report = replace(
        full.report,
        channel=SEPARATED,
        light=light.outcome,
        reason=light.reason,
        wall_albedo=tuple(light.albedo.tolist()),
        albedo_given=prior.is_given,
        indirect_percent=tuple(percent),
        indirect_factor=light.factor,
        lamp=light.lamp,
        other_cut=found.other_cut,
    )
    problem = replace(problem, report=report).in_units()
    problem = _with_contours(problem, outcome, trial.min_steepness)
    if outcome is ContourOutcome.BY_LINES:
        return problem, None
    return problem, trial.surface.start_of(problem)


def estimate_indirect(
    colours: Sequence[Problem],
    surface: Iterate,
    prior: AlbedoPrior,
    per_pixel: bool = False,
) -> tuple[FloatArray, Light]:
    """Return ι (H, W, 3) of a surface, refined if `per_pixel`, and what the colours tell of its light."""
    green = colours[1]
    k = green.photometry.k
    v = surface.log_distance
    mask = np.any([colour.mask for colour in colours], axis=0) & np.isfinite(v)
    cuts = surface.problem.cuts
    walls = Walls.of(v, mask, green.field, k, cuts, green.lamp_ratio)
    light = fit_light(Patches.of(colours, walls), prior)
    ratio = light.indirect_ratio(walls, k)
    return (refine_per_pixel(colours, ratio, light) if per_pixel else ratio), light


def _solve_direct(
    picture: Problem,
    light: Light,
    indirect_ratio: FloatArray,
    surface: Iterate | None,
    number: int,
    count: int,
    **options: Any,
) -> Solving[Iterate]:
    """Solve without the indirect light, from a surface, if there is one: `count` steps, as round `number`."""
    problem = merge(picture.colours, indirect_ratio, light.albedo, not light.reason)
    if surface is not None:
        problem = replace(problem, cuts=surface.problem.cuts)
        options["start"] = surface.start_of(problem)
    return (
        yield from solve_stage(problem, BOUNCED, number, max_iterations=count, **options)
    )


def solve_stage(
    problem: Problem, stage: str, number: int = 0, **options: Any
) -> Solving[Iterate]:
    """Solve a problem as a round of a stage, from the surface of the one before; return the answer.

    A cut one is near: what moves far hangs by few pixels, and coarser grids do not see these.
    """
    halvings = 0 if problem.cuts is not None else 1
    options = {"halvings": halvings} | options
    return (yield from name_stage(gauss_newton(problem, **options), stage, number))


# Contours -------------------------------------------------------------------------------


def _try_contours(
    uncut: Trial, colours: Sequence[Problem], prior: AlbedoPrior | None, number: int = 0
) -> Solving[list[Trial]]:
    """Cut a surface at ever less steep lines; return what is found each time, the uncut surface first.

    Where colours tell which is right, the first two start from the uncut surface, side by side. All others
    start from the one before. `number` is the first trial's round.
    """
    picture = uncut.surface.problem
    lines = find_contours(picture.log_d0, picture.mask)
    options: dict[str, Any] = {}
    if colours:
        # Where a trial is chosen by its energy, that must be near its end.
        count = constants.UNCUT_ROUNDS[0] if uncut.is_direct else constants.TRIAL_STEPS
        options["max_iterations"] = count

    def solve(index: int, start: Iterate) -> Solving[Iterate]:
        problem = replace(picture, cuts=lines > steep[index])
        how = {"start": start.log_distance, **options}
        return solve_stage(problem, CONTOURS, number + index, **how)

    steep = [least for least in constants.MIN_STEEPNESS if (lines > least).any()]
    trials = [uncut]
    together = []
    if uncut.light.outcome is LightOutcome.REMOVED:
        together = run_together([solve(i, uncut.surface) for i in range(len(steep[:2]))])
    for index, steepness in enumerate(steep):
        if index < len(together):
            surface = yield from together[index]
        else:
            surface = yield from solve(index, trials[-1].surface)
        trial = replace(uncut, surface=surface, min_steepness=steepness)
        if prior is not None and not uncut.is_direct:
            ratio, light = estimate_indirect(colours, surface, prior)
            trial = replace(trial, indirect_ratio=ratio, light=light)
        trials.append(trial)
        # Less steep lines might do better where nothing bounced, or while the colours agree as well.
        is_as_good = _colours_tell(trials) and trial.light.misfit <= _misfit_limit(trials)
        if not uncut.is_direct and not is_as_good:
            break
    return trials


def choose(
    trials: Sequence[Trial], always: bool = False, doubt: float = 1.0
) -> tuple[Trial, ContourOutcome]:
    """Return the trial that is taken, and what decided; the uncut one is the first.

    The uncut surface is not taken if there are to be contours `always`. Where colours do not tell it from
    those that are cut, that one is taken whose log energy and cuts cost least. The limit of misfits may be
    another by a factor, `doubt`.
    """
    uncut = trials[0]
    allowed = trials[1:] if always and len(trials) > 1 else trials
    if _colours_tell(trials):
        limit = doubt * _misfit_limit(allowed)
        allowed = [trial for trial in allowed if trial.light.misfit <= limit]
        if allowed[0] is not uncut:
            return allowed[0], ContourOutcome.BY_COLOURS
    price = constants.CLEAN_PRICE if uncut.is_direct else constants.PRICE
    cheapest = min(
        allowed,
        key=lambda trial: np.log(trial.surface.energy) + price * trial.cut_length,
    )
    is_cut = cheapest is not uncut
    return cheapest, ContourOutcome.BY_ENERGY if is_cut else ContourOutcome.NONE_CLEAR


def _colours_tell(trials: Sequence[Trial]) -> bool:
    """Whether light bounced, and what the colours say of the first two surfaces can be."""
    bounced = trials[0].light.outcome is LightOutcome.REMOVED
    return bounced and not any(trial.light.reason for trial in trials[:2])


def _misfit_limit(trials: Sequence[Trial]) -> float:
    """Return the largest misfit at which a surface is as good as the best of these."""
    least = min(trial.light.misfit for trial in trials)
    return constants.MISFIT_LIMIT * max(trials[0].light.factor, 1.0) * least


def cut_at_contours(problem: Problem, min_steepness: float | None) -> Problem:
    """Cut the surface at the picture's lines that are steeper than this, if there are any."""
    if min_steepness is None:
        return problem
    cuts = find_contours(problem.log_d0, problem.mask) > min_steepness
    return replace(problem, cuts=cuts if cuts.any() else None)


def tissue_cuts(colours: Sequence[Problem]) -> BoolArray | None:
    """Return where living tissue is cut, if anywhere.

    Lines are those of log 1/I in red, in which vessels hardly show: a light's law that is guessed
    makes lines of its own, and colours that say no one E where one is clipped.
    """
    red = colours[0]
    log_dark = -np.log(np.where(red.mask, red.image, 1.0))
    cuts = find_contours(log_dark, red.mask, in_tissue=True) > constants.TISSUE_STEEPNESS
    return cuts if cuts.any() else None


def min_steepness_of(result: Result) -> float | None:
    """Return how steep the lines are at which a surface is cut; the steepest, if cuts were given."""
    if result.problem.cuts is None:
        return None
    return result.report.min_steepness or constants.MIN_STEEPNESS[0]


# Colours --------------------------------------------------------------------------------


def merge(
    colours: Sequence[Problem],
    indirect_ratio: FloatArray,
    albedo: FloatArray,
    agree: bool = True,
) -> Problem:
    """Merge red, green and blue of one picture into one problem of direct light, given ι (H, W, 3).

    It is green's, with the picture that direct light alone would have made. Each colour counts by its
    noise, its texture and what may be wrong with ι; what is saturated does not. If colours do not `agree`,
    one that is saturated in most places does not count at all: its rest would be at odds with them.
    """
    gamma = colours[1].photometry.gamma
    mask = np.any([colour.mask for colour in colours], axis=0)
    kinds = np.full((3, *mask.shape), EXACT, np.int8)
    for kind, colour in zip(kinds, colours, strict=True):
        if colour.evidence is not None:
            kind[:] = colour.evidence
        kind[~colour.mask] = NONE
        if not agree and np.mean(kind[colour.mask] == LOWER_BOUND) > 0.5:
            kind[:] = NONE
    evidence = kinds.min(axis=0)  # EXACT before LOWER_BOUND before NONE
    total = np.zeros(mask.shape)
    weights = np.where(mask, 0.0, 1.0)
    for c, colour in enumerate(colours):
        ratio = indirect_ratio[..., c]
        noise = max(colour.noise, ROUNDING)
        shade = np.maximum(colour.image, noise)
        variance = (gamma * noise / shade) ** 2
        variance += (constants.RATIO_DOUBT * ratio / (1 + ratio)) ** 2
        variance += constants.TEXTURE[c] ** 2
        weight = (colour.mask & (kinds[c] == evidence)) / variance
        log_albedo = np.log(albedo[1] / albedo[c])
        total += weight * (gamma * np.log(shade) - np.log1p(ratio) + log_albedo)
        weights += weight
    image = np.where(mask, np.exp(total / weights / gamma), 0.0)
    evidence[~mask] = EXACT
    return replace(
        colours[1], image=image, mask=mask, evidence=evidence if evidence.any() else None
    )
