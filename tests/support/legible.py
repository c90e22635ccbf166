"""The texts of a figure, and whether they can be read in a column of a journal."""

import re

from matplotlib.text import Text

COLUMN = 85.0 / 25.4  # inches, of a journal
SMALLEST = 6.0  # points that can be read there


def letters(figure):
    """Every text that is seen: matplotlib keeps ticks beyond the ends of an axis, and does not draw them."""
    unseen = set()
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            slack = 1e-9 * (high - low)
            for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks()):
                if not low - slack <= tick.get_loc() <= high + slack:
                    unseen |= {tick.label1, tick.label2}
    texts = (t for t in figure.findobj(Text) if t.get_visible() and t not in unseen)
    return [t for t in texts if t.get_text().strip()]


def assert_legible(figure):
    """No text is below SMALLEST points in a column, outside the paper, or on top of another or of the axes."""
    texts = letters(figure)
    assert {t.get_fontsize() >= SMALLEST * figure.get_figwidth() / COLUMN for t in texts} == {True}
    assert not any("$" in t.get_text() for t in texts)  # exponents and indices would be smaller
    boxes = [(t.get_text(), t.get_window_extent()) for t in texts]
    paper = figure.bbox
    for text, box in boxes:
        assert box.x0 >= -1 and box.y0 >= -1 and box.x1 <= paper.x1 + 1 and box.y1 <= paper.y1 + 1, text
    for i, (text, box) in enumerate(boxes):
        on = [other for other, place in boxes[:i] if place.padded(-1.0).overlaps(box.padded(-1.0))]
        assert not on, (text, on)
    for axes in figure.axes:
        frame = axes.get_window_extent().padded(-1.0)
        inside = [text for text, box in boxes if box.overlaps(frame)]
        assert not [text for text in inside if not re.fullmatch(r"\([a-h]\)", text)]  # letters of panels
