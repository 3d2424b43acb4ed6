"""Check of a reconstruction's memory needs against the memory limit."""

from __future__ import annotations

from steradian.core.exceptions import InvalidInput
from steradian.core.system_resources import available_memory


def check_memory(needed: int, limit: int | None, shape: tuple[int, ...], images: int = 1) -> None:
    """Raise an error, before allocation, if a reconstruction needs more than ``limit`` or the available bytes.

    Parameters
    ----------
    needed
        Bytes, or a lower bound of them.
    limit
        What the user allowed; None: what is available.
    shape
        Of the image, for the message.
    images
        How many of them are kept.

    Raises
    ------
    InvalidInput
        With both numbers: of ``memory_limit`` where one was given, else of ``modes``, the most likely cause, or of
        ``traces`` where they make several images.
    """
    image = " × ".join(map(str, shape))
    if limit is not None:
        if needed > limit:
            which = "this image" if images == 1 else f"these {images} images"
            raise InvalidInput("memory_limit", limit, f"at least {needed} bytes for {which} of {image} voxels")
        return
    there = available_memory()
    if there is not None and needed > there and images > 1:
        raise InvalidInput(
            "traces",
            f"{images} sets",
            f"what the available {there} bytes of memory can hold; as many images of {image} voxels need at least "
            f"{needed} (fewer sets at once need less)",
        )
    if there is not None and needed > there:
        raise InvalidInput(
            "modes",
            " × ".join(map(str, shape[:-1])),
            f"what the available {there} bytes of memory can hold; {image} voxels need at least {needed} "
            f"(fewer modes, fewer depths or less upsampling need less)",
        )
