"""What the tuner says of an answer: one line, and sentences that warn."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from endolab.reconstruction.contrast import ENOUGH_CONTRAST
from endolab.workbench.tuning.engine import Answer, Stage
from endolab.workbench.tuning.tried import Tried, differs_by_lam, way_to_go


@dataclass(frozen=True)
class WarningLimits:
    """When a sentence warns, chosen on the scenes that students begin with."""

    difference: float = 10.0  # %; two surfaces that differ by more are not the same
    # Share of the cut steps by which contours may change without a word.
    cut_elsewhere: float = 0.1


LIMITS = WarningLimits()


@dataclass(frozen=True)
class Warning:
    """What should be known before an answer is believed."""

    chip: str  # few words
    sentence: str


def is_too_smooth(answer: Answer) -> bool:
    """Whether too little of the picture's contrast is explained, and λ can help."""
    return answer.uses_lam and answer.explained_contrast < ENOUGH_CONTRAST


def summary(answer: Answer, tried: Sequence[Tried] = ()) -> str:
    """Say in one line what an answer is and how it came about, beside what else was tried."""
    settings = answer.settings
    result = answer.result
    parts = [settings.solver.replace("_", " ")]
    if answer.uses_lam:
        order = f"{result.problem.regulariser} order"
        order += " (auto)" * (settings.regulariser == "auto")
        parts = [f"λ {settings.lam:.3g}", order]
    explained = f"explains {100 * answer.explained_contrast:.1f} %"
    if is_too_smooth(answer):
        explained += f", too little: {way_to_go(tried, answer)}"
    parts += [explained, f"residual {answer.residual_size:.1f} grey levels"]
    ended: str = answer.stage
    if ended == Stage.FINAL:
        ended = result.status.name.lower().replace("_", " ")
    if answer.stage == Stage.PASSED:
        iterate = result.iterate
        ended = f"{iterate.stage}, iteration {iterate.k}"
    elif answer.stage != Stage.LOOK:
        ended += f" in {answer.seconds:.1f} s"
    parts.append(ended)
    if answer.median_error is not None:
        parts.append(f"median error {answer.median_error:.2f} %")
    return " · ".join(parts)


def warnings(answer: Answer, before: Tried | None) -> list[Warning]:
    """Say what should be known before an answer is believed; `before` is the last one."""
    if answer.stage != Stage.FINAL:
        return []
    found = [Warning(re.split("[:;,]", one)[0].rstrip("."), one) for one in answer.warnings]
    if before is not None and differs_by_lam(before.settings, answer.settings):
        most = max(before.cut_count, answer.cut_count)
        if abs(before.cut_count - answer.cut_count) > LIMITS.cut_elsewhere * most:
            sentence = (
                f"Contours changed with λ: {before.cut_count:,} px were cut at λ {before.settings.lam:.2g}, "
                f"and {answer.cut_count:,} are now."
            )
            found.append(Warning("other contours", sentence))
    if answer.change is not None:
        size = np.abs(answer.change[answer.result.mask])
        share = 100 * np.mean(size > LIMITS.difference)
        if share > 0:
            sentence = (
                f"A solve that starts from the last answer ends elsewhere: {share:.2g} % of the pixels "
                f"differ by more than {LIMITS.difference:g} %, one by {size.max():.3g} %."
            )
            found.append(Warning(f"not unique: {share:.2g} % of pixels", sentence))
    return found
