"""Whether there is memory for what is to be done, asked before it is begun."""

import psutil

RENDERING_BYTES = 500  # bytes a pixel, at least, to render a picture of a known scene


def check_memory(needed: float, what: str, remedy: str = "") -> None:
    """Raise a MemoryError in one sentence, if `what` needs more bytes than are free."""
    free = psutil.virtual_memory().available
    if needed > free:
        raise MemoryError(
            f"{what} needs about {needed / 1e9:.1f} GB of memory, {free / 1e9:.1f} GB are free{remedy}"
        )
