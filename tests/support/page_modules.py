"""The page's own modules, called in the browser as the page calls them."""

import contextlib
import json

import numpy as np

TYPED = "given.plane.values = Float32Array.from(given.plane.values);"


class Modules:
    """Calls functions of modules on a page of a service."""

    def __init__(self, page):
        self.page = page

    def call(self, module, script, **given):
        """Run a function body with a module as ``m`` and what is given as ``given``; arrays travel as lists."""
        body = f"async (given) => {{ const m = await import('/static/{module}'); {script} }}"
        return self.page.evaluate(body, json.loads(json.dumps(given, default=np.ndarray.tolist)))


@contextlib.contextmanager
def modules_of(chromium, service):
    """Open a page that has little else to do."""
    page, faults = chromium.new_page(), []
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.goto(f"{service.url}/data")
    yield Modules(page)
    page.close()
    assert faults == []


def plane(values, origin, spacing):
    """A plane of numbers as measurements.js takes it; values stay a list, for :data:`TYPED` to make an array of."""
    return {"values": values.ravel(), "shape": values.shape, "origin": origin, "spacing": spacing}
