"""A volume's page: where its crosshair is, what its canvases show, and drawing in them."""

import numpy as np

VIEWS = {"x–y": ("x", "y"), "x–z": ("x", "z"), "y–z": ("y", "z")}
AXES = "xyz"
BRIGHT = """(canvas) => {
    const {width, height} = canvas;
    const {data} = canvas.getContext("2d").getImageData(0, 0, width, height);
    let [most, x, y, count] = [1, 0, 0, 0];
    for (let n = 0; n < width * height; n++) {
        const sum = data[4 * n] + data[4 * n + 1] + data[4 * n + 2];
        if (sum > most) [most, x, y, count] = [sum, 0, 0, 0];
        if (sum === most) { x += n % width; y += Math.floor(n / width); count += 1; }
    }
    return count && most > 300 ? {x: x / count + 0.5, y: y / count + 0.5, width, height} : null;
}"""


def drawn(page):
    """Wait until every view of a volume shows something; returns the page."""
    page.wait_for_selector("[data-view='3-D']")
    page.wait_for_function("() => [...document.querySelectorAll('.message')].every((one) => one.hidden)", polling=100)
    page.wait_for_selector("#volume[data-surveyed]")
    return page


def brightest_pixel(canvas):
    """Middle of the brightest pixels of a canvas, and the canvas's size."""
    return canvas.evaluate(BRIGHT)


def crosshair(page):
    return [float(page.get_attribute(f"[data-place] [data-axis='{axis}']", "data-value")) for axis in AXES]


def figure(page, name):
    return float(page.get_attribute(f"[data-figure='{name}']", "data-value"))


def number_in(field):
    """Number in a text field of the page, which shows a typographic minus."""
    return float(field.input_value().replace("−", "-"))


def spacing(volume):
    return [1e3 * (line[1] - line[0]) for line in (volume.x, volume.y, volume.z)]


def scale_of(page, volume):
    """Pixels a mm has, worked out from the panels' sizes: the largest at which every view shows what is not cropped."""
    extents = dict(zip(AXES, np.multiply(volume.values.shape, spacing(volume)), strict=True))
    first, last = shown_depths(page)
    extents["z"] = last - first
    fits = []
    for view, (across, up) in VIEWS.items():
        box = page.locator(f"[data-view='{view}']").bounding_box()
        fits.append(min(box["width"] / extents[across], box["height"] / extents[up]))
    return 0.94 * min(fits)


def shown_depths(page):
    """First and last depth in mm that the views show."""
    return [float(one) for one in page.get_attribute("#volume", "data-depths").split(",")]


def pixel_of(page, volume, view, place):
    """Where a place in mm lies in a view, by the page's promise: the middle of what is shown in the middle."""
    box = page.locator(f"[data-view='{view}']").bounding_box()
    lines = dict(zip(AXES, (volume.x, volume.y, volume.z), strict=True))
    middle = {axis: 1e3 * (line[0] + line[-1]) / 2 for axis, line in lines.items()}
    middle["z"] = sum(shown_depths(page)) / 2
    at, (across, up) = dict(zip(AXES, place, strict=True)), VIEWS[view]
    way = -1 if up == "y" else 1
    scale = scale_of(page, volume)
    x = box["width"] / 2 + scale * (at[across] - middle[across])
    return x, box["height"] / 2 + way * scale * (at[up] - middle[up])


def drag(page, view, start, end):
    box = page.locator(f"[data-view='{view}']").bounding_box()
    page.mouse.move(box["x"] + start[0], box["y"] + start[1])
    page.mouse.down()
    page.mouse.move(box["x"] + (start[0] + end[0]) / 2, box["y"] + (start[1] + end[1]) / 2)
    page.mouse.move(box["x"] + end[0], box["y"] + end[1])
    page.mouse.up()
