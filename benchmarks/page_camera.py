"""Pictures of one page, in both themes and several sizes of the window."""

import io
import re
from contextlib import contextmanager

from PIL import Image

from page import address
from steradian_benchmarks.paper.pictures import few_colours

SIZES = {"": (1280, 720), "tablet-": (1024, 768), "wide-": (1440, 900)}
ALSO = {"design", "volume"}
"""Pages that are shown at all sizes anyway: they look differently there."""
WAIT = 240_000.0


class Camera:
    """Opens pages in every theme and size, and keeps what they look like."""

    def __init__(self, service, browser, folder, *, sizes, only):
        self.service, self.browser, self.folder, self.sizes, self.only = service, browser, folder, sizes, only

    def take(self, name, path, ready, *, act=None, during=None):
        """Keep ``name-dark.png`` and ``name-light.png`` of an address, once ``ready`` is seen and ``act`` was done.

        ``during`` makes sure, before and after, that what is shown is still under way; such a page never rests.
        """
        if not re.search(self.only, name):
            return
        for prefix, size in SIZES.items():
            if prefix and not (prefix in self.sizes or name in ALSO):
                continue
            for theme in ("dark", "light"):
                with self._page(path, ready, theme, size) as page:
                    if act is not None:
                        act(page)
                    if during is None:
                        page.wait_for_load_state("networkidle")
                    else:
                        during()
                    page.wait_for_timeout(700)  # pictures that are drawn when the page rests
                    shot = page.screenshot()
                    if during is not None:
                        during()
                    self._keep(shot, f"{name}-{prefix}{theme}.png")

    @contextmanager
    def _page(self, path, ready, theme, size):
        context = self.browser.new_context(
            viewport=dict(zip(("width", "height"), size, strict=True)), color_scheme=theme, reduced_motion="reduce"
        )
        context.set_default_timeout(WAIT)
        page = context.new_page()
        page.goto(address(self.service, path))
        page.wait_for_selector(ready)
        yield page
        context.close()

    def _keep(self, shot, name):
        picture = few_colours(Image.open(io.BytesIO(shot)).convert("RGB"))
        picture.save(self.folder / name, "png", optimize=True)
