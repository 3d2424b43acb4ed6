"""Pictures for the documents: small, and in the colours that were drawn."""

import numpy as np
import pytest
from PIL import Image

from steradian.drawing.style import colours
from steradian_benchmarks.paper.pictures import few_colours


def off(picture, original):
    return np.abs(np.asarray(picture.convert("RGB")).astype(int) - original).max()


def test_palette_reduction_preserves_drawn_colours():
    """A picture of a page: a dark map of colours, a white panel, text in greys, and a small sign in amber."""
    page = np.full((300, 400, 3), 255, np.uint8)
    page[:200, :256] = colours("inferno")[np.linspace(0, 255, 200).astype(int)][:, None]
    page[250:260, :256] = np.arange(256, dtype=np.uint8)[None, :, None]
    page[270:274, 300:310] = (255, 179, 0)
    found = few_colours(Image.fromarray(page))
    assert found.mode == "P"
    assert off(found, page.astype(int)) <= 12


@pytest.mark.long
def test_palette_reduction_skips_images_with_too_many_colours():
    noise = np.random.default_rng(1).integers(0, 256, (200, 200, 3)).astype(np.uint8)
    assert off(few_colours(Image.fromarray(noise)), noise.astype(int)) == 0
