"""What the numbers of a result mean, what they rest on, what is doubtful: all sentences about it."""

from collections.abc import Iterator, Mapping, Set
from typing import Any

import numpy as np

from endolab.frames.boxes import find_box
from endolab.frames.frame import SATURATED
from endolab.frames.surround import surround_doubts
from endolab.metrics.contrast import ENOUGH_CONTRAST, explained_contrast, noise_left
from endolab.model.photometry import CHANNELS
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.iteration import Status
from endolab.reconstruction.lamps import BOUNDS
from endolab.reconstruction.light_and_contours import BOUNCED, CONTOURS, SMOOTH
from endolab.reconstruction.patches import find_patch
from endolab.reconstruction.scale import pixel_name, scale_of
from endolab.solvers.linearised import far_end_by_gamma
from endolab.solvers.problem import LOWER_BOUND, NONE, Problem
from endolab.solvers.provenance import ContourOutcome, LightOutcome, Report
from endolab.solvers.result import Iterate, Result

WITHOUT_RAY = 0.02  # of the picture's pixels, from which on it is doubtful
SOLVER_NAMES = {
    "gauss_newton": "Gauss-Newton",
    "primal_dual": "primal-dual",
    "fast_marching": "fast marching",
    "facing": "facing",
}


def meaning(result: Result | Iterate) -> tuple[str, ...]:
    """Say in a sentence each what the numbers of a result mean and what they rest on.

    The unit and what fixes it; the wall's albedo; light that bounced; γ; pixels that are saturated or
    say nothing; what was noted on the way.
    """
    return (
        *_of_scale(result),
        *_of_wall(result),
        _of_gamma(result),
        *_of_evidence(result.problem),
        *notes(result),
    )


def notes(result: Result | Iterate) -> tuple[str, ...]:
    """Say what was done about lamps, indirect light and contours, and why, in a sentence each."""
    report = result.report
    return (
        *_of_picture(report),
        *_of_lamps(result),
        *_of_light(report),
        *_of_contours(report),
    )


def _of_picture(report: Report) -> Iterator[str]:
    """Say that a run was stopped early, that a calibration was scaled, and that a box was left out."""
    if report.stage:
        yield (
            f"It was stopped in the stage '{report.stage}': light and contours were still being looked for."
        )
    own = report.picture_size
    known = None if report.calibration is None else report.calibration.camera
    if own and known and own != (known.width, known.height):
        yield (
            f"The calibration, for {known.width}x{known.height} px, was scaled to the picture's "
            f"{own[0]}x{own[1]}."
        )
    if report.box_share:
        yield (
            f"{100 * report.box_share:.2g} % of the picture is a box of one colour, as a menu is, and was "
            "left out; with --mask only what the mask says is."
        )


def _of_light(report: Report) -> Iterator[str]:
    if report.light is LightOutcome.GREY:
        yield (
            "The picture is grey, so that light which came by way of other walls cannot be told from the "
            "lamp's: it was left in."
        )
    elif report.light is LightOutcome.NO_COLOUR:
        yield (
            f"The colours tell nothing of bounced light ({report.reason}), so {report.channel} is taken "
            "as it is."
        )
    elif report.light is LightOutcome.NONE_BOUNCED:
        yield "The colours show no indirect light, and none was removed."
    elif report.light is not None:
        albedos = ", ".join(f"{value:.2f}" for value in report.wall_albedo)
        red, green, blue = report.indirect_percent
        removed = (
            f"red {red:.0f} %, green {green:.0f} %, blue {blue:.0f} % of the direct light"
        )
        if report.light is LightOutcome.COMPUTED:
            whose = "given albedos" if report.albedo_given else "albedos of tissue"
            yield (
                f"Indirect light removed: {removed}. The colours do not tell how much there is "
                f"({report.reason}), so it was computed with {whose}: {albedos}."
            )
        else:
            whose = "given" if report.albedo_given else "estimated"
            yield (
                f"Indirect light removed: {removed} (medians). By the colours it is "
                f"{report.indirect_factor:.2f} times what the surface predicts with {whose} albedos "
                f"{albedos}; {100 * report.lamp:.0f} % of k is the lamp's."
            )


def _of_contours(report: Report) -> Iterator[str]:
    if report.contours in (None, ContourOutcome.NOT_ASKED, ContourOutcome.GIVEN):
        return
    if report.cut_links:
        yield f"Contours: the surface is cut over {report.cut_links:,} px ({report.contours.value})."
    else:
        yield "Contours: none is cut, as no line of the picture gives clear evidence."
    if report.other_cut is not None:
        steepness, moves = report.other_cut
        how = "uncut" if steepness is None else f"cut at lines > {steepness:g}"
        yield (
            f"Two answers were near: {how} instead, the far end, a twentieth of the pixels, comes "
            f"{100 * abs(moves):.2g} % {'farther' if moves > 0 else 'nearer'}, with the same median."
        )


def _of_scale(result: Result | Iterate) -> Iterator[str]:
    report = result.report
    kind = scale_of(result)
    if kind == "gain":
        yield "Distances are in mm, because the gain of the endoscope is known."
    elif kind == "median distance":
        yield f"Distances are in mm, because their median was given as {report.length:g} mm."
    elif kind == "known distance":
        mm, *pixel = report.length
        where = pixel_name(pixel)
        yield f"Distances are in mm, because the surface at {where} was given as {mm:g} mm away."
    elif kind == "known diameter":
        mm, start, end = report.length
        where = f"{pixel_name(start)} and {pixel_name(end)}"
        yield f"Distances are in mm, because the points at {where} were given as {mm:g} mm apart."
    elif result.problem.metric:
        yield "Distances are in mm, and the scale is carried over from the frame before."
    elif kind == "none":
        yield "The gain is unknown: distances show the shape, and their unit is arbitrary."
    else:
        yield "The gain is unknown: distances have an arbitrary unit, nearly that of the frame before."
    if report.length_by_gain is not None:
        yield f"By the gain of the calibration that length would be {report.length_by_gain:.3g} mm."


def _of_wall(result: Result | Iterate) -> Iterator[str]:
    yield (
        "The wall is assumed to reflect the same everywhere; a patch that reflects 10 % more comes out "
        "5 % too near."
    )
    if scale_of(result) == "gain":  # else the value cancels
        yield (
            "Distances go with the square root of albedo times gain: "
            "if that product is really 10 % higher, every distance is 5 % too short."
        )
    if result.report.albedo is None:
        yield (
            "Indirect light, which bounced from wall to wall, counts as direct; in simulated colons it adds "
            "about 120 % to red, 30 % to green and 20 % to blue."
        )


def _of_lamps(result: Result | Iterate) -> Iterator[str]:
    """Say where the lamps stand and what they change, by ω: distances go with its square root."""
    report, ratio = result.report, result.problem.lamp_ratio
    if not report.lamps or ratio is None:
        return
    places = " and ".join(f"({x:g}, {y:g}, {z:g})" for x, y, z in report.lamps)
    ratio = ratio[result.mask]
    factor = np.sqrt(ratio if scale_of(result) == "gain" else ratio / np.median(ratio))
    far = result.distance[result.mask]
    moves = 100 * (factor - 1)
    end = float(np.median(moves[far >= np.quantile(far, 0.95)]))
    whose = (
        "lamps that were given"
        if report.evidence.get("lamps") == "given"
        else "calibration's lamps"
    )
    yield (
        f"The {whose} stand at {places} mm (right, down, forward of the lens): their places move distances "
        f"by {np.mean(np.abs(moves)):.2g} % in the mean, and the far end, a twentieth of the pixels, "
        f"{abs(end):.2g} % {'farther' if end > 0 else 'nearer'}."
    )
    if scale_of(result) == "none":
        yield "For that the median distance was assumed as usual of this endoscope: the unit stays arbitrary."
    bounded = float(np.mean((ratio <= BOUNDS[0]) | (ratio >= BOUNDS[1])))
    if bounded > 0.01:
        yield (
            f"{100 * bounded:.2g} % of the pixels are so near to a lamp, or so far to its side, that its "
            "light was bounded there."
        )


def _of_gamma(result: Result | Iterate) -> str:
    """Tell what another γ does to the far end: one larger by 0.1, for a nominal one a display's 2.2."""
    gamma = result.problem.photometry.gamma
    is_nominal = "photometry" in result.report.nominal
    other = 2.2 if is_nominal else gamma + 0.1
    iterate = result.iterate if isinstance(result, Result) else result
    moves = 100 * far_end_by_gamma(iterate, other - gamma)
    what = ""
    if is_nominal:
        what = "No calibration of the light: k and γ are nominal. "
        if "camera" in result.report.nominal:
            what = "No calibration: camera, k and γ are nominal; shape only. "
    way = "farther" if moves > 0 else "nearer"
    return (
        f"{what}With γ {other:.3g} in place of {gamma:.3g} the far end, a twentieth of the pixels, comes "
        f"{abs(moves):.2g} % {way}, with the same median."
    )


def nominal_light(result: Result) -> Iterator[str]:
    """Say what it may cost that nobody measured the light, if so."""
    if "photometry" in result.report.nominal:
        yield _of_gamma(result)


def notes_on_pixels(
    problem: Problem, field_of_view: BoolArray, with_ray: BoolArray
) -> Iterator[str]:
    """Say what of a picture was solved, in a sentence each, from what the endoscope shows on, maps (H, W)."""
    share = 100 * field_of_view.mean()
    yield f"The endoscope shows, and the mask keeps, {share:.3g} % of the picture."
    for part, why in (
        (field_of_view & ~with_ray, "has no ray within 80° of the axis"),
        (with_ray & ~problem.mask, "is too dark to tell a distance"),
    ):
        if part.any():
            share = 100 * part[field_of_view].mean()
            yield f"{share:.2g} % of that {why}, and is left out."
    yield from (*_of_picture(problem.report), *_of_evidence(problem))
    treated = {"keep": "were not looked for", "inpaint": "were filled in from around"}
    if problem.report.highlights in treated:
        yield f"Highlights {treated[problem.report.highlights]}, and count as the wall."


def _of_evidence(problem: Problem) -> Iterator[str]:
    """Say how many pixels are saturated, and how many say nothing."""
    if problem.evidence is None:
        return
    known = problem.evidence[problem.mask]

    for kind, what, how in (
        (
            LOWER_BOUND,
            "The sensor is saturated in",
            "which count as 'at least this bright'",
        ),
        (NONE, "Highlights and overlays hide", "where the surface is interpolated"),
    ):
        count = int((known == kind).sum())
        if count:
            share = 100 * count / known.size
            yield f"{what} {count} of {known.size} pixels ({share:.2g} %), {how}."


def describe_left(result: Result) -> str:
    """Say how far a result is from its energy's minimum."""
    share = f"{100 * result.left:.0f} %" if result.left >= 0.01 else "less than 1 %"
    return f"one step of Gauss-Newton would lower its energy by {share}"


def summary(result: Result, sigma: FloatArray | None = None) -> Iterator[str]:
    """Say what a run found, a line each, as the command line prints it; σ (H, W), if it is known."""
    known = result.distance[result.mask]
    yield f"{result.status.name}: {result.status.value.rstrip('.')}; {describe_left(result)}."
    yield (
        f"{result.iterations} iterations, {result.seconds:.2f} s, energy {result.energy:.3e}, "
        f"{known.size} pixels"
    )
    yield (
        f"distance: median {np.median(known):.4g}, from {known.min():.4g} to {known.max():.4g} "
        f"({result.problem.unit})"
    )
    field = result.report.field_seen
    yield "field: {}x{} px, {:.0f}° across".format(*field["px"], field["degrees"])
    yield from (*nominal_light(result), *notes(result))
    yield from (*_of_evidence(result.problem), *warnings(result))
    if sigma is not None:
        percent = 100 * sigma[result.mask] / known
        low, middle, high = np.percentile(percent, [10, 50, 90])
        yield f"σ of the distance: {middle:.2g} % for the median pixel, {low:.2g} to {high:.2g} %"


def prior_notes(
    measured: Mapping[str, float], assumed: Mapping[str, float], is_unmeasured: bool
) -> Iterator[str]:
    """Say which standard deviations are a calibration's and which are assumed."""
    listed, stated = (
        ", ".join(f"{name} ± {value:.2g}" for name, value in part.items())
        for part in (measured, assumed)
    )
    if measured:
        yield f"Standard errors of the calibration: {listed}."
    why = "The calibration states no standard errors"
    if is_unmeasured:
        why = "Light partly uncalibrated" if measured else "Light uncalibrated"
    if assumed:
        yield f"{why}; assuming {stated}."


def light_verdict(estimate: Any) -> str:
    """Say in a sentence or two what a `LightEstimate` tells of the light's fall-off."""
    count = len(estimate.names)
    frames = f"{count} frame{'s' * (count > 1)}"
    taken = f"{estimate.photometry.k:.3g} is taken."
    found = f"{estimate.k:.1f} ± {estimate.standard_error:.1f}, by {frames}"
    if estimate.outcome == "found":
        verdict = f"The light falls off with k = {found}."
    elif estimate.outcome == "roughly":
        verdict = f"The light falls off with k = roughly {found}; {taken}"
    else:
        low, high = estimate.interval
        why = f"{low:.1f} to {high:.1f} are likely"
        if estimate.k > estimate.exponents[-2]:
            why = f"it would be {estimate.exponents[-1]:g} or more"
        verdict = f"k is not found: by {frames}, {why}; {taken}"
    if estimate.places < 0.75 * count:
        verdict += f" They show much the same, and count as {estimate.places:.1f}."
    return f"{verdict} They do not tell γ, taken to be {estimate.photometry.gamma:g}."


# Doubts: nothing is refused, since a frame may be a rare one ------------------------------


def warnings(result: Result, turned: Set[str] = frozenset()) -> Iterator[str]:
    """Say what can hardly be true of a result, a sentence each; usually nothing.

    What may be the cause begins with options that were `turned`.
    """
    problem = result.problem
    mask = result.mask
    widest = np.degrees(np.arccos(np.clip(problem.field.cos_alpha[mask].min(), -1, 1)))
    if widest < 5:  # endoscopes see 35 to 85
        yield f"The camera sees only {widest:.2g}° to the side: its focal length may be wrong."
    median = float(np.median(result.distance[mask]))
    if result.metric and not 2 <= median <= 300:
        yield (
            f"The median distance is {median:.4g} mm, where endoscopes see 2 to 300 mm: gain, k, γ, albedo "
            "or a given length may be wrong."
        )
    explained = explained_contrast(result)
    picture = problem.shown
    in_tissue = result.report.light is LightOutcome.COMPUTED
    # Frames of cavities have 0.99 and more; living tissue, whose vessels and wet spots no surface explains,
    # has 0.956 and more.
    if explained < (0.95 if in_tissue else 0.97):
        solver = str(result.report.asked.get("solver", ""))
        by_newton = solver == "gauss_newton"
        usual = "in tissue 95 % and more" if in_tissue else "99 %"
        # What may be where little is explained, and by which options.
        options = {
            "wet spots, vessels": {"highlights", "channel"},
            "folds that were not found": {"contours"},
            "another k or γ": {"k", "gamma"},
            "λ too large": {"lam", "regulariser", "epsilon", "xi"},
        }
        causes = sorted(options, key=lambda cause: turned.isdisjoint(options[cause]))
        why = (
            f"{usual} is usual. What may be: {', '.join(causes)}, or no endoscope's frame."
        )
        # Where Gauss-Newton ends by itself .18 is left at most, and of primal-dual's surfaces .24 and more.
        if not (by_newton and result.status.is_done) and result.left > 0.2:
            why = (
                f"{SOLVER_NAMES.get(solver, 'the solver')} has not come to the energy's minimum: "
                f"{describe_left(result)}; {'more steps do' if by_newton else 'solver gauss_newton does'}."
            )
        yield (
            f"The surface explains {100 * max(explained, 0):.0f} % of the picture's contrast; {why}"
        )
    # Usual frames have up to .0003, once the picture was averaged.
    if noise_left(result)[0] ** 2 > 0.5 * np.var(problem.image[mask]):
        yield "More than half of the picture's contrast is noise: it may show nothing, or no cavity."
    blown_out = np.zeros_like(mask)
    if problem.evidence is not None:
        blown_out = mask & (problem.evidence == LOWER_BOUND)
    share = float(blown_out[mask].mean())
    if share >= 0.05:
        yield (
            f"{100 * share:.0f} % is saturated: at least that bright, and maybe nearer; less exposure would "
            "tell more."
        )
    if picture.ndim == 3:
        red, _, blue = np.median(picture[mask], axis=0)
        if blue > red:
            yield "Blue is brighter than red, unlike tissue: they may be swapped, or the picture inverted."
        # Not those of the one channel that is solved: `meaning` tells of them.
        lost = np.mean(picture[mask & ~blown_out] >= SATURATED, axis=0)
        for name, share in zip(CHANNELS, lost, strict=True):
            # Usual frames have up to .03.
            if share > 0.1 and result.report.channel == "separated":
                yield (
                    f"{name.capitalize()} is saturated in {100 * share:.0f} % of the picture, which the "
                    "other colours tell alone; less exposure would tell more."
                )
    brightest = float(picture[mask].max())
    if brightest < 0.1:  # that of a usual frame has 0.8 and more
        yield (
            f"The brightest pixel has {100 * brightest:.2g} % of what the file can hold: it may use fewer "
            "bits than the file, such as 12 of 16."
        )
    misplaced = result.report.misplaced
    if misplaced:
        yield (
            f"{100 * misplaced:.0f} % of the mask lies beyond what the endoscope shows, and was "
            "left out: the mask may be another camera's."
        )
    kept = result.report.shown_share
    if kept < 0.2:
        yield (
            f"The mask keeps {100 * kept:.2g} % of what the endoscope shows: it should be bright where the "
            "frame is to be used."
        )
    without_ray = result.report.without_ray
    if without_ray >= WITHOUT_RAY:
        yield (
            f"{100 * without_ray:.0f} % of what the endoscope shows has no ray, and is left out: "
            "the camera's model ends or turns back before the picture does."
        )
    is_unclear, are_two = surround_doubts(picture, mask)
    if are_two:
        yield (
            "The picture shows two fields of view, apart from each other, and the surface is of one: cut the "
            "picture in two, or choose one with --mask."
        )
    if is_unclear:
        yield (
            "Corners of the picture have one flat colour and no clear edge: if they surround what the "
            "endoscope shows, a mask must leave them out."
        )
    scale = np.divide(result.report.picture_size or mask.shape[::-1], mask.shape[::-1])
    patch = find_patch(result)
    if patch is not None:
        column, row = np.rint(scale * patch[:2]).astype(int)
        kind = "brighter" if patch[2] > 1 else "darker"
        yield (
            f"A closed ring is left in the residual: about column {column}, row {row} all is "
            f"{100 * abs(patch[2] - 1):.0f} % {kind}, as a stain or a painted polyp is, and may be flat."
        )
    box = find_box(picture, mask)
    if box is not None:
        left, right, top, bottom = np.rint(np.repeat(scale, 2) * box).astype(int)
        yield (
            f"Columns {left} to {right - 1}, rows {top} to {bottom - 1} have straight edges, as a menu or a "
            "second picture has: if they show no wall, leave them out with --mask."
        )
    lamps = result.report.lamps
    if lamps and problem.lamp_ratio is None:
        aside = max(np.hypot(x, y) for x, y, _ in lamps)
        yield (
            f"The lamps stand up to {aside:.2g} mm aside, which needs millimetres and was left out: add "
            "--median-distance."
        )
    albedo = float(np.min(getattr(problem.photometry.brdf, "albedo", 1.0)))
    if albedo < 0.05:
        yield f"An albedo of {albedo:.2g} is too dark for tissue, which has 0.1 to 0.8."


def describe(
    result: Result, explained: float, reached: str, errors: tuple[float, float] | None
) -> str:
    """Say in the tuner's line what solved a result, what it explains, and how it ended.

    `reached` is "look" or "iterate" of what is still moving; `errors` are the mean and the median, %.
    While light and contours are looked for, it says so.
    """
    looked_for = {SMOOTH: "folds", BOUNCED: "bounced light", CONTOURS: "folds"}
    if reached == "iterate" and result.iterate.stage in looked_for:
        return f"looking for {looked_for[result.iterate.stage]}"
    asked = result.report.asked
    solver = str(asked.get("solver", "gauss_newton"))
    parts = [SOLVER_NAMES[solver]]
    if solver in ("gauss_newton", "primal_dual"):
        problem = result.problem
        parts += [f"λ {problem.lam:.3g}", f"{problem.regulariser} order"]
    if reached != "look":  # which has solved few pixels
        worse = "" if explained >= 0 else ", worse than a flat wall"
        parts.append(f"explains {100 * max(explained, 0):.1f} %{worse}")
    if errors is not None:
        mean, median = (f"{error:.{2 if error < 1 else 1}f} %" for error in errors)
        parts.append(f"error: mean {mean}, median {median}")
    if reached == "look":
        ended = "follows the hand"
    elif reached == "iterate":
        ended = f"iterate {result.iterate.k}, still falls"
    else:
        status = result.status.name.lower().replace("_", " ")
        ended = f"{status} in {result.seconds:.1f} s"
        # Where Gauss-Newton has converged there is next to nothing, and the answer is to be seen at once.
        if solver != "gauss_newton" or result.status is not Status.CONVERGED:
            ended = f"{ended}; {describe_left(result)}"
    return " · ".join([*parts, ended])


def advice(explained: float, lam: float, best: float | None) -> str:
    """Say what to do about a surface that explains too little; nothing where nothing is known to help.

    98.5 % leads to errors as small as 99 % does, and so does a λ that is near the best.
    """
    if explained >= ENOUGH_CONTRAST - 0.005 or best is None or lam < 3 * best:
        return ""
    return f"too smooth: λ {best:.2g} explains 99 %"


def what_changed(before: Result, now: Result, lines: int) -> str:
    """Say what asking anew has changed; `lines` is by how many more lines the surface is cut."""
    contours = "contours: as many"
    if lines:
        contours = f"contours: {abs(lines)} {'more' if lines > 0 else 'fewer'}"
    deepest = [float(np.nanmax(one.distance)) for one in (before, now)]
    return f"asked anew: {contours}; deepest {deepest[0]:.3g} → {deepest[1]:.3g} {now.problem.unit}"
