"""What was tried in this session: how much each λ explains, by which λ is chosen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from endolab.reconstruction.contrast import suggest_lam
from endolab.workbench.tuning.engine import LAM_FACTORS, Answer
from endolab.workbench.tuning.source import Knobs


@dataclass(frozen=True)
class Tried:
    """What is kept of an answer."""

    settings: Knobs
    explained: float
    roughness: float
    contours: int  # the same number for the same cuts
    cut_count: int

    @classmethod
    def of(cls, answer: Answer) -> Tried:
        """Note what is kept."""
        return cls(
            answer.settings,
            answer.explained_contrast,
            answer.roughness,
            answer.contours,
            answer.cut_count,
        )


def differs_by_lam(settings: Knobs, other: Knobs) -> bool:
    """Whether two settings differ by λ, if at all."""
    return replace(settings, lam=other.lam) == other


def lines_of(tried: Sequence[Tried], answer: Answer) -> list[list[Tried]]:
    """What differs from an answer by λ alone, a line by λ for each set of contours, the answer's last."""
    lines: dict[int, list[Tried]] = {}
    for one in sorted(tried, key=lambda one: one.settings.lam):
        if differs_by_lam(one.settings, answer.settings):
            lines.setdefault(one.contours, []).append(one)
    own = lines.pop(answer.contours, [])
    return [*lines.values(), own]


def suggested_lam(tried: Sequence[Tried], answer: Answer) -> float | None:
    """Return the largest λ that explains enough with the answer's contours; None if none is known to."""
    line = lines_of(tried, answer)[-1]
    return suggest_lam([one.settings.lam for one in line], [one.explained for one in line])


def way_to_go(tried: Sequence[Tried], answer: Answer) -> str:
    """Say which λ explains enough, for an answer that does not."""
    best = suggested_lam(tried, answer)
    if best is not None:
        return f"λ {best:.2g} explains 99 %"
    if len(lines_of(tried, answer)[-1]) < len(LAM_FACTORS):
        return "less λ"
    return (
        "no λ tried explains 99 %, as where walls are wet or noisy, or the light is another"
    )
