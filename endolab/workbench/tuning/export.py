"""What is written of an answer: all there is about it, in a folder that makes it again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from endolab.io.atomic import read_bytes, stage_folder, write_atomically
from endolab.io.descriptions import write_calibration
from endolab.io.found import save_found
from endolab.io.images import write_image
from endolab.io.settings import write_settings
from endolab.reconstruction.pipeline import reconstruct, solve_found
from endolab.workbench.tuning.engine import Answer

# What an export makes its answer again by.
RESULT = """from pathlib import Path

import endolab as el
from endolab.io.settings import read_settings

here = Path(__file__).parent
saved = read_settings(here / "settings.json")
calibration = saved.apply(el.load_calibration(here / "endoscope.json"))  # what is believed
found = el.load_found(saved.found)  # light and contours
result = el.solve_found(found, calibration, **saved.keywords)
"""


def export(
    answer: Answer, folder: str | Path, overwrite: bool, board: bytes | None
) -> Sequence[str]:
    """Write it, all or none, and say what could not be drawn; `board` is the page as it is seen, PNG."""
    # These draw: who waits for a first surface need not wait for them.
    from endolab.workbench.recording.recorder import record
    from endolab.workbench.reports.result import save_result

    subject = answer.still.subject
    found = answer.still.found
    assert found is not None
    trusted = answer.uncertainty
    saved = replace(answer.settings.solving_settings(subject), found="found.npz")
    known = answer.settings.endoscope(subject.calibration)
    with stage_folder(folder, overwrite=overwrite) as staging:
        with record(staging / "recording.rrd", truth=subject.truth) as recorder:
            anew = partial(reconstruct, subject.frame)
            solve = anew if answer.is_anew else partial(solve_found, found)
            believed = answer.settings.calibration_of(subject)
            solve(believed, observers=[recorder], **saved.keywords)
            if trusted is not None:
                recorder.add_uncertainty(trusted, answer.result)
        undrawn = recorder.undrawn
        save_result(
            answer.result,
            staging,
            uncertainty=trusted,
            overwrite=True,
            undrawn=undrawn,
        )
        if board is not None:
            write_atomically(staging / "board.png", board)
        # The camera that is believed in now is the one beside it.
        beside = replace(found.believed, camera=known.camera)
        save_found(replace(found, believed=beside), staging / "found.npz")
        picture = "frame.png" if subject.path is None else subject.path.name
        if subject.path is None:
            write_image(staging / picture, subject.frame.image, bits=16)
        else:
            write_atomically(staging / picture, read_bytes(subject.path))
        if not subject.frame.mask.all():
            write_image(staging / "mask.png", subject.frame.mask.astype(float))
            saved = replace(saved, mask="mask.png")
        write_calibration(known, staging / "endoscope.json")
        write_settings(saved, staging / "settings.json")
        write_atomically(staging / "result.py", RESULT.encode())
    return undrawn
