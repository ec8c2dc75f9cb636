"""Direct light out of a colour picture: what bounced is computed from the surface and removed.

A wall of albedo a shows I_c = g a/π (E + S), the lamp's light E and light S from other walls. The
three colours see one E, but the more a colour is reflected, the more of it bounces. From a surface
that is known roughly follows ι = S/E for each colour (`interreflection`); divided by 1 + ι, the three
pictures are three measurements of E, which are merged and solved, and ι follows anew from a better
surface.

Albedos that are not given are found from the colours: the tissue looks more alike all over the
picture the better the bounced light is known. At last the tint of each place tells where ι is still wrong.

This is the stage "bounced light and contours found" of a reconstruction. What it solves on the way
it yields, iterate by iterate: `BOUNCED` names the stage, beside those of `contours`.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from endolab.depth.gauss_newton import gauss_newton
from endolab.depth.problem import EXACT, NONE, Problem
from endolab.depth.provenance import Searched
from endolab.depth.result import Iterate, Result, carrying, staged
from endolab.model.endoscope import Endoscope
from endolab.model.interreflection import Walls
from endolab.model.photometry import CHANNELS
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.iteration import Status
from endolab.numerics.side_by_side import by_rows
from endolab.preprocessing.contours import find_contours
from endolab.preprocessing.frame import BRIGHT, QUIET, Frame, noise_level
from endolab.reconstruction.colours import (
    ALBEDOS,
    ALIKE,
    TEXTURE,
    Belief,
    Light,
    NoColour,
    Patches,
    all_exact,
    by_tint,
    found_light,
)
from endolab.reconstruction.contours import (
    BARS,
    CONTOURS,
    ENERGY,
    PRICE,
    THE_COLOURS,
    OneChannel,
    bar_of,
    choose_bar,
    enlarged_cuts,
    length_of,
    pays,
    remarked_on_contours,
    torn_at_contours,
)
from endolab.reconstruction.problem_setup import (
    SEPARATED,
    PosedProblem,
    Preparation,
    enlarged,
    in_units,
    on_grid,
    resampled,
    two_sizes,
)

BOUNCED = "bounced light"  # stage
DOUBT = 0.15  # share of ι that may be wrong
GUESS = 0.5  # of s in ι = s a/(1 - s a), before there is a surface
GUESSED_BAR = 0.8  # lines of a picture without as much light everywhere are so much less steep
SAME = 0.01  # median difference of stored values, as a share, up to which two colours are one
ROUND_STEPS, TORN_STEPS = (8, 4, 3), 3  # of each round's solve, and of each bar's
# Of the last one, by the tint of each place. Asked earlier, it makes all surfaces agree with the colours,
# which are to choose among them.
TINTED_STEPS = 2
# Of the surfaces that are torn over one bar or another, the least torn is taken whose misfit of the colours
# is at most so many times the least, or, if that is the whole one, the one whose energy speaks for its cuts;
# beyond this, no lower bar is tried. It is p times as many where the colours ask for more bounced light than
# walls make, as on C3VD's phantom: they are believed less.
AS_GOOD = 1.07
WITNESS = 1.5  # p beyond which the colours ask for more bounced light than walls can make: not believed
# Where no light bounced: the share of its energy that a cut as long as the picture's height must save, and
# how steep lines must be at least.
CLEAN_PRICE, CLEAN_BAR = 0.02, 0.018


@dataclass(frozen=True)
class Colours:
    """A frame prepared for the separation: red, green and blue, in full and as wide as it needs."""

    fine: list[PosedProblem]
    coarse: list[PosedProblem]
    albedo: FloatArray | None  # of the wall: (3,), green's alone, (), or None, as the calibration tells

    @classmethod
    def of(cls, frame: Frame, calibration: Endoscope, preparation: Preparation) -> Colours:
        """Prepare the three colours. Highlights are ignored by default."""
        if frame.image.ndim == 2:
            raise ValueError(f"{frame.name} is grey, and channel='separated' needs its three colours")
        preparation = replace(preparation, highlights=preparation.highlights or "ignore")
        fine, coarse = two_sizes(frame, calibration, preparation, CHANNELS)
        return cls(fine, coarse, _albedos(calibration))


@dataclass(frozen=True)
class Separation:
    """What was found of a picture's bounced light."""

    indirect_ratio: FloatArray  # (H, W, 3), ι in red, green and blue; 0 where nothing is known
    light: Light
    # Of the last problem that was solved. Its cuts are the contours that were found, over `provenance.bar`.
    surface: Iterate
    cue: str = ""  # what decided on them


# The stage ------------------------------------------------------------------------------


def direct_light(
    colours: Colours, contours: bool | None = None, before: Result | None = None
) -> Generator[Iterate, None, tuple[PosedProblem, FloatArray | None]]:
    """Find the light that has not bounced; every solve's iterates are yielded, stage and round named.

    `contours` says whether to tear the surface at those that are found, by default if that explains the
    picture much better. An earlier result of the last frame, `before`, makes one round enough; one of this
    frame tells all of it. Returns the problem of direct light in full, or of the clearest colour alone where
    they tell nothing, and log d (H, W) to begin with, or None.
    """
    given = colours.albedo
    if colours.fine[0].problem.discontinuities is not None:
        contours = False  # they are known
    known = None if before is None else _as_before(colours, before, contours)
    if before is not None and known is not None:
        return known, on_grid(before.iterate, known.problem)
    try:
        if before is None:
            separation = yield from separate(colours.coarse, given, contours)
        else:
            surface = resampled(before.iterate, colours.coarse[1].problem)
            bar = None if contours is False else bar_of(before)
            # Another frame has other lines; those of the same one stay.
            same = np.array_equal(before.problem.shown, colours.fine[1].problem.shown)
            searched = before.provenance.searched if same else None
            separation = yield from continued(colours.coarse, given, surface, bar, searched)
    except NoColour as error:
        index = max((1, 2, 0), key=lambda index: _signal(colours.fine[index].problem))  # of equals, not red
        note = f"The colours tell nothing of bounced light ({error}), so {CHANNELS[index]} is taken as it is."
        clearest = OneChannel(colours.fine[index].remarked(note), colours.coarse[index])
        return (yield from choose_bar(clearest, contours, before))
    three = given is not None and given.ndim == 1
    posed = _in_full(colours.fine, separation, three, contours is not False)
    posed = replace(posed, provenance=replace(posed.provenance, given_albedo=_as_told(given)))
    return posed, on_grid(separation.surface, posed.problem)


def _as_before(colours: Colours, before: Result, contours: bool | None) -> PosedProblem | None:
    """The problem that an earlier result solves, if it is of the same picture: light and lines are known."""
    fine, old, settings = colours.fine[1], before.problem, before.provenance.settings
    new, torn = fine.problem, old.discontinuities is not None
    asked = {name: value for name, value in fine.provenance.settings.items() if name != "channel"}
    same = (
        before.status is Status.CONVERGED
        and settings.get("channel") == SEPARATED
        and before.provenance.given_albedo == _as_told(colours.albedo)
        and all(settings.get(name) == value for name, value in asked.items())
        and contours in (None, torn)
        and new.discontinuities is None
        and torn == (before.provenance.bar is not None)
        and old.camera == new.camera
        and replace(old.photometry, gain=None) == replace(new.photometry, gain=None)
        and np.array_equal(old.shown, new.shown)
        and np.array_equal(old.mask, np.any([colour.problem.mask for colour in colours.fine], axis=0))
    )
    if not same:
        return None
    known = replace(
        new, image=old.image, mask=old.mask, evidence=old.evidence, discontinuities=old.discontinuities
    )
    kept = {name: settings[name] for name in ("channel", "contours", "albedo", "notes") if name in settings}
    provenance = replace(before.provenance, scale=None, settings=fine.provenance.settings | kept)
    return PosedProblem(in_units(known), provenance)


def _as_told(albedo: FloatArray | None) -> tuple[float, ...] | None:
    return None if albedo is None else tuple(np.ravel(albedo).tolist())


def separate(
    posed: Sequence[PosedProblem], albedo: FloatArray | None = None, contours: bool | None = None
) -> Generator[Iterate, None, Separation]:
    """Find the bounced light of a picture, its surface, and where it is torn, in rounds.

    Some of the whole surface, one for each bar of the torn one, and a last one by the tint of each place.

    `posed` are red, green and blue of one picture; `albedo` is what is known of the wall's: (3,), green's
    alone, or nothing. Raises `NoColour` if the colours are one.
    """
    colours = [colour.problem for colour in posed]
    _check_colours(colours)
    belief = Belief.of(albedo)
    indirect_ratio = _guess(colours, belief)
    solver = gauss_newton(merged(colours, indirect_ratio, belief.albedo), max_iterations=ROUND_STEPS[0])
    surface = yield from staged(carrying(solver, posed[1].provenance), BOUNCED, 1)
    whole = Separation(indirect_ratio, belief.light, surface)
    for number, steps in enumerate(ROUND_STEPS[1:], 2):
        whole = yield from _round(colours, belief, whole.surface, number, steps)
    if contours is False:
        found = Separation(*_bounced(colours, whole.surface, belief), whole.surface)
    else:
        trials = yield from _torn(colours, whole, belief)
        number += len(trials) - 1
        found = trials[0] if len(trials) == 1 else _chosen(trials, always=bool(contours))
    if _none_bounced(found) or found.light.refused:
        return found
    tinted = by_tint(colours, found.indirect_ratio, found.light), found.light
    surface = yield from _taken_out(colours, *tinted, found.surface, number + 1, TINTED_STEPS)
    return Separation(*_bounced(colours, surface, belief, tinted=True), surface, found.cue)


def _torn(
    colours: Sequence[Problem], whole: Separation, belief: Belief
) -> Generator[Iterate, None, list[Separation]]:
    """Go on with the surface torn; return what is found over each bar, the whole surface first.

    Where a fold hides a wall, a surface that goes on smoothly sends light to the wrong places, and the three
    colours of what is seen agree less on the light that has not bounced. So they tell over which of `BARS`
    lines are to be opened: one bar after the other is tried, each from the surface before.
    """
    searched = Searched(whole.indirect_ratio, whole.light.albedo)
    surface = replace(whole.surface, provenance=replace(whole.surface.provenance, searched=searched))
    trials = [Separation(*_bounced(colours, surface, belief), surface)]
    number, lines = len(ROUND_STEPS), find_contours(surface.problem.log_facing, surface.problem.mask)
    for bar in (*BARS, CLEAN_BAR) if _none_bounced(trials[0]) else BARS:
        before = trials[-1].surface
        torn = torn_at_contours(before.problem, bar, lines)
        if torn.discontinuities is None:
            continue
        number += 1
        solver = gauss_newton(torn, start=before.log_distance, max_iterations=TORN_STEPS)
        provenance = replace(before.provenance, bar=bar)
        surface = yield from staged(carrying(solver, provenance), CONTOURS, number)
        trials.append(Separation(*_bounced(colours, surface, belief), surface))
        if not _goes_on(trials):
            break
    return trials


def _none_bounced(trial: Separation) -> bool:
    return trial.light.factor == trial.light.film == 0 and not trial.light.refused


def _bear_witness(trials: Sequence[Separation]) -> bool:
    return not any(trial.light.refused or trial.light.factor > WITNESS for trial in trials[:2])


def _as_good(trials: Sequence[Separation], allowed: Sequence[Separation]) -> float:
    """The misfit up to which colours do not prefer another of the surfaces; the whole one is the first."""
    margin = AS_GOOD * max(trials[0].light.factor, 1.0)
    return margin * min(trial.light.misfit for trial in allowed)


def _goes_on(trials: Sequence[Separation]) -> bool:
    """Whether a lower bar might be better than those that were tried, the whole surface first."""
    if _none_bounced(trials[0]):
        return True
    last = trials[-1].light.misfit
    return _bear_witness(trials) and last <= _as_good(trials, trials)


def _chosen(trials: Sequence[Separation], always: bool) -> Separation:
    """The surface that colours speak for, or else the energy; the whole one, the first, not with `always`."""
    whole, torn = trials[0], trials[1]
    allowed = trials[1:] if always else trials
    if _none_bounced(whole):  # the picture is the model's own, and so is its energy
        return _cheapest(allowed, CLEAN_PRICE)
    if not _bear_witness(trials):
        return replace(torn if always or pays(torn.surface, whole.surface) else whole, cue=ENERGY)
    limit = _as_good(trials, allowed)
    as_good = [trial for trial in allowed if trial.light.misfit <= limit]
    return _cheapest(as_good, PRICE) if as_good[0] is whole else replace(as_good[0], cue=THE_COLOURS)


def _cheapest(trials: Sequence[Separation], price: float) -> Separation:
    """The surface of least energy, where a cut as long as the picture's height must save a share of it."""

    def charged(trial: Separation) -> float:
        discontinuities, mask = trial.surface.problem.discontinuities, trial.surface.mask
        return float(np.log(trial.surface.energy)) + price * length_of(discontinuities, mask)

    return replace(min(trials, key=charged), cue=ENERGY)


def continued(
    posed: Sequence[PosedProblem],
    albedo: FloatArray | None,
    log_distance: FloatArray,
    bar: float | None = None,
    searched: Searched | None = None,
) -> Generator[Iterate, None, Separation]:
    """Do the same with a surface that is nearly the right one, the last frame's say: one round.

    `log_distance` is its log d (H, W), nan where unknown, in the unit that the gain of `posed` gives. If
    there is a `bar`, it is torn at this frame's lines over it, or those of the picture that was `searched`.
    """
    colours, belief = [colour.problem for colour in posed], Belief.of(albedo)
    searched = searched or Searched(_guess(colours, belief), belief.albedo, GUESSED_BAR)
    provenance = replace(posed[1].provenance, bar=bar, searched=searched)
    problem = replace(colours[1], discontinuities=None)
    if bar is not None:
        problem = replace(problem, discontinuities=_lines(colours, searched, bar))
    surface = Iterate(problem, 0, log_distance, {}, provenance=provenance)
    return (yield from _round(colours, belief, surface, 1, ROUND_STEPS[0], tinted=True))


def _guess(colours: Sequence[Problem], belief: Belief) -> FloatArray:
    """ι before there is a surface, (H, W, 3): one number a colour."""
    guess = np.array(GUESS * belief.albedo / (1 - GUESS * belief.albedo))
    return np.broadcast_to(guess, (*colours[1].mask.shape, 3))


def _lines(colours: Sequence[Problem], searched: Searched, bar: float) -> BoolArray | None:
    """Lines of the picture that is searched.

    What bounces on a torn surface takes so much light from limbs, and from what lies behind folds, that new
    lines would come of it: so it is that without the light that bounced on the surface when it was whole.
    """
    indirect_ratio = enlarged(searched.indirect_ratio, colours[1].mask.shape)
    picture = merged(colours, indirect_ratio, searched.albedo)
    return torn_at_contours(picture, searched.share * bar).discontinuities


def _round(
    colours: Sequence[Problem],
    belief: Belief,
    surface: Iterate,
    number: int,
    steps: int,
    tinted: bool = False,
) -> Generator[Iterate, None, Separation]:
    """Take out the light that bounces on a surface, and solve again from there."""
    bounced = _bounced(colours, surface, belief, tinted)
    return Separation(*bounced, (yield from _taken_out(colours, *bounced, surface, number, steps)))


def _taken_out(
    colours: Sequence[Problem],
    indirect_ratio: FloatArray,
    light: Light,
    surface: Iterate,
    number: int,
    steps: int,
) -> Generator[Iterate, None, Iterate]:
    """Solve again from a surface, without this light."""
    problem = merged(colours, indirect_ratio, light.albedo)
    if surface.problem.discontinuities is not None:
        problem = replace(problem, discontinuities=surface.problem.discontinuities)
    v = surface.log_distance
    start = np.where(np.isfinite(v), v, problem.log_facing)
    solver = carrying(gauss_newton(problem, start=start, max_iterations=steps), surface.provenance)
    return (yield from staged(solver, BOUNCED, number))


def _in_full(fine: list[PosedProblem], separation: Separation, given: bool, asked: bool) -> PosedProblem:
    """Return the problem of the light that has not bounced, at full size.

    `given`: whether the albedos were, `asked`: whether contours were looked for.
    """
    colours, surface = [colour.problem for colour in fine], separation.surface
    shape = colours[1].mask.shape
    problem = merged(colours, enlarged(separation.indirect_ratio, shape), separation.light.albedo)
    discontinuities = surface.problem.discontinuities
    if discontinuities is not None:
        if separation.cue == ENERGY or discontinuities.shape[1:] == shape:  # it chose these very lines
            discontinuities = enlarged_cuts(discontinuities, shape)
        else:  # colours choose a bar
            searched = surface.provenance.searched or Searched(
                separation.indirect_ratio, separation.light.albedo
            )
            discontinuities = _lines(colours, searched, bar_of(surface) or BARS[0])
        problem = replace(problem, discontinuities=discontinuities)
    medians = [100 * np.median(s[s > 0]) if (s > 0).any() else 0.0 for s in separation.indirect_ratio.T]
    note = separation.light.describe(given, np.array(medians))
    provenance = replace(fine[1].provenance, bar=surface.provenance.bar, searched=surface.provenance.searched)
    posed = PosedProblem(in_units(problem), provenance)
    posed = posed.noted(channel=SEPARATED, contours=problem.discontinuities is not None)
    if separation.indirect_ratio.any():
        albedo = tuple(float(value) for value in separation.light.albedo)
        provenance = replace(posed.provenance, albedo=albedo)
        posed = PosedProblem(posed.problem, provenance).noted(albedo=list(albedo))
    posed = posed.remarked(note)
    return remarked_on_contours(posed, separation.cue) if asked else posed


# Colours --------------------------------------------------------------------------------


def merged(colours: Sequence[Problem], indirect_ratio: FloatArray, albedo: FloatArray) -> Problem:
    """Merge red, green and blue of one picture into one problem of direct light, given ι (H, W, 3).

    It is green's, with the picture that direct light alone would have made. Each colour counts by its
    noise, its texture and what may be wrong with ι; what is saturated does not.
    """
    gamma = colours[1].photometry.gamma
    mask = np.any([colour.mask for colour in colours], axis=0)
    kinds = np.stack([np.where(colour.mask, _evidence(colour), NONE) for colour in colours])
    evidence = kinds.min(axis=0).astype(np.int8)  # EXACT before AT_LEAST before NONE
    noises = [max(noise_level(colour.image, colour.mask), QUIET) for colour in colours]
    image = np.empty(mask.shape)

    def merge(rows: slice) -> None:
        total, weights = np.zeros(mask[rows].shape), np.zeros(mask[rows].shape)
        for c, (colour, noise, rho, texture) in enumerate(zip(colours, noises, albedo, TEXTURE, strict=True)):
            s, speaks = indirect_ratio[rows, :, c], colour.mask[rows] & (kinds[c, rows] == evidence[rows])
            shade = np.maximum(colour.image[rows], noise)
            doubt = (gamma * noise / shade) ** 2 + (DOUBT * s / (1 + s)) ** 2 + texture**2
            weight = np.where(speaks, 1 / doubt, 0.0)
            total += weight * (gamma * np.log(shade) - np.log1p(s) + np.log(albedo[1] / rho))
            weights += weight
        light = np.where(mask[rows], np.exp(total / np.where(mask[rows], weights, 1.0)), 0.0)
        image[rows] = light ** (1 / gamma)

    by_rows(merge, mask.shape)
    return replace(
        colours[1],
        image=image,
        mask=mask,
        evidence=np.where(mask, evidence, EXACT).astype(np.int8) if evidence[mask].any() else None,
    )


def _evidence(problem: Problem) -> NDArray[np.int8]:
    return np.zeros(problem.mask.shape, np.int8) if problem.evidence is None else problem.evidence


def _signal(problem: Problem) -> float:
    """Median grey level over noise; less where much is saturated."""
    image = problem.image[problem.mask]
    noise = max(noise_level(problem.image, problem.mask), QUIET)
    return float(np.median(image) * np.mean(image < BRIGHT)) / noise


def _check_colours(colours: Sequence[Problem]) -> None:
    """Raise NoColour if the three are one picture, such as a grey one that was stored as RGB."""
    mask = np.all([colour.mask for colour in colours], axis=0)
    if mask.any():
        images = [colour.image[mask] for colour in colours]
        if max(np.median(np.abs(colour / images[1] - 1)) for colour in images) < SAME:
            raise NoColour("red, green and blue are one")


# Albedos and ι --------------------------------------------------------------------------


def _albedos(calibration: Endoscope) -> FloatArray | None:
    """Albedos in red, green and blue, (3,), or green's alone, (), as far as they can be: else None."""
    albedo = np.asarray(getattr(calibration.photometry.brdf, "albedo", 0.0), dtype=np.float64)
    low, high = (0.0, 1.0) if albedo.ndim else ALBEDOS
    uniform = albedo.ndim > 0 and np.ptp(albedo) < ALIKE * albedo.max()
    return albedo if np.all((low < albedo) & (albedo < high)) and not uniform else None


def _bounced(
    colours: Sequence[Problem], surface: Iterate, belief: Belief, tinted: bool = False
) -> tuple[FloatArray, Light]:
    """ι (H, W, 3) of a surface, and what the colours tell of its light; of each place too if `tinted`."""
    green, v = colours[1], surface.log_distance
    if not all_exact(colours).any():
        raise NoColour("no pixel shows all three of them")
    mask = np.any([colour.mask for colour in colours], axis=0) & np.isfinite(v)
    walls = Walls.of(v, mask, green.field, green.photometry.k, surface.problem.discontinuities)
    light = found_light(Patches.of(colours, walls), belief)
    indirect_ratio = light.indirect_ratio(walls, green.photometry.k)
    return by_tint(colours, indirect_ratio, light) if tinted else indirect_ratio, light
