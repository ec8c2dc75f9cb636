"""What the tuner says of an answer: one line, and sentences that warn."""

from dataclasses import dataclass

import numpy as np

from endolab.workbench.tuning.engine import Answer, Stage
from endolab.workbench.tuning.panels import Dot, differs_by_lam


@dataclass(frozen=True)
class WarningLimits:
    """When a sentence warns, chosen on the scenes that students begin with."""

    difference: float = 1.0  # %; two surfaces that differ by more are not the same
    # Share of the cut steps by which contours may change without a word.
    cut_elsewhere: float = 0.1


LIMITS = WarningLimits()


def summary(answer: Answer) -> str:
    """Say in one line how an answer came about."""
    settings = answer.settings
    result = answer.result
    auto = " (auto)" if settings.regulariser == "auto" else ""
    ended: str = answer.stage
    if ended == Stage.FINAL:
        ended = result.status.name.lower().replace("_", " ")
    parts = [f"λ {settings.lam:.2g}", f"{result.problem.regulariser}{auto}"]
    if answer.cut_count:
        parts.append(f"{answer.cut_count:,} px cut")
    parts.append(ended)
    if answer.stage != Stage.LOOK:
        parts.append(f"{answer.seconds:.1f} s")
    if answer.median_error is not None:
        parts.append(f"median error {answer.median_error:.2f} %")
    return " · ".join(parts)


def warnings(answer: Answer, before: Dot | None) -> list[str]:
    """Say in a sentence each what should be known before an answer is believed; `before` is the last one."""
    if answer.stage != Stage.FINAL:
        return []
    sentences = [*answer.warnings]
    if before is not None and differs_by_lam(before.settings, answer.settings):
        most = max(before.cut_count, answer.cut_count)
        if abs(before.cut_count - answer.cut_count) > LIMITS.cut_elsewhere * most:
            sentences.append(
                f"Contours changed with λ: {before.cut_count:,} px were cut at λ {before.settings.lam:.2g}, "
                f"and {answer.cut_count:,} are now."
            )
    if answer.change is not None:
        size = np.abs(answer.change[answer.result.mask])
        if size.max() > LIMITS.difference:
            share = 100 * np.mean(size > LIMITS.difference)
            sentences.append(
                f"A solve that starts from the last answer ends elsewhere: {share:.2g} % of the pixels "
                f"differ by more than {LIMITS.difference:g} %, one by {size.max():.3g} %."
            )
    return sentences
