"""Animations of a run: its saved times, one after the other."""

from __future__ import annotations

import io
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from PIL import Image

from hjprofile.errors import InputError, RunError
from hjprofile.files import write_whole
from hjprofile.interrupts import undone
from hjprofile.output.plots import style
from hjprofile.output.plots.style import DEPOSITED, ERODED, INK, amount, styled
from hjprofile.problem.ranges import as_number, as_path, instance, shown
from hjprofile.solvers.run import Array, Run

DPI = 120  # 600 pixels wide
FPS = 8.0
SLOWEST, FASTEST = 0.01, 50.0  # images per second; a GIF stores their duration in whole hundredths of a second
LAST = 1.5  # duration of the last image in seconds
COLOURS = 64  # in the palette of a GIF
FORMS = ".gif", ".mp4"


def animate(run: Run, path: str | Path, fps: float = FPS, progress: Callable[[float], None] | None = None) -> Path:
    """Write the saved times of a run as an animation.

    Args:
        run: the run.
        path: the file, which ends in .gif, or in .mp4 if the program ffmpeg is installed. Its folder is created.
        fps: the number of saved times per second, from 0.01 to 50.
        progress: a function that is called with the completed fraction in [0, 1].

    Returns:
        The path of the file, which is complete or absent.

    Raises:
        InputError: for another ending, for a rate out of range, and for an MP4 without ffmpeg.
        RunError: if ffmpeg fails.
        OSError: if the file cannot be written.

    >>> import tempfile
    >>> from pathlib import Path
    >>> import hjprofile as hj
    >>> problem = hj.Problem(hj.rational(), hj.kinks([-2.0], [1.0]), end=0.1, snapshots=2)
    >>> run = hj.solve_hj(problem, hj.Grid(left=-4.0, cells=40))
    >>> hj.animate(run, Path(tempfile.mkdtemp()) / "slope.gif").name
    'slope.gif'
    """
    instance("run", run, Run)
    path = as_path("path", path)
    write_whole(path, animation(run, path.suffix.lower(), fps, progress or (lambda _: None)))
    return path


@styled
def animation(run: Run, form: str, fps: float = FPS, progress: Callable[[float], None] = lambda _: None) -> bytes:
    """Return the saved times as a ".gif" or an ".mp4", `fps` of them per second. `progress` receives the finished
    fraction.

    Raise InputError for another form, for a rate out of range, and for MP4 without ffmpeg.
    """
    if form not in FORMS:
        raise InputError(f"an animation ends in {' or '.join(FORMS)}, not in {form!r}", "a-moving-picture")
    if not SLOWEST <= as_number(fps) <= FASTEST:
        raise InputError(
            f"fps = {shown(fps)} must be a positive number of images per second, from {SLOWEST:g} to {FASTEST:g}",
            "a-moving-picture",
        )
    ffmpeg = shutil.which("ffmpeg")
    if form == ".mp4" and ffmpeg is None:
        raise InputError(
            "an MP4 needs the program ffmpeg, which is not on the PATH; install it, or write a .gif", "a-moving-picture"
        )
    images = []
    for i, image in enumerate(frames(run)):
        images.append(image)
        progress((i + 1) / run.time.size)
    return _gif(images, fps) if ffmpeg is None or form == ".gif" else _mp4(images, fps, ffmpeg)


def frames(run: Run) -> Iterator[Array]:
    """Yield an image of each saved time, shape (rows, columns, 3), with even numbers of rows and columns.

    Draw the artists that do not move only once.
    """
    figure, moving, show = _animated_figure(run)
    for artist in moving:
        artist.set_animated(True)
    canvas: Any = figure.canvas
    canvas.draw()
    still = canvas.copy_from_bbox(figure.bbox)
    for i in range(run.time.size):
        show(i)
        canvas.restore_region(still)
        for artist in moving:
            (artist.axes or figure).draw_artist(artist)
        image = np.asarray(canvas.buffer_rgba())[..., :3]
        yield image[: image.shape[0] // 2 * 2, : image.shape[1] // 2 * 2].copy()


@styled
def _animated_figure(run: Run) -> tuple[Figure, list[Any], Callable[[int], None]]:
    """Return the figure, its moving artists in drawing order, and the function that shows a saved time."""
    x, u, x_label, u_label = style.axes_units(run, run.units)
    unit = [f"areas and supplied volume per width in {run.units.label}²"] if run.units else []
    figure = style.sheet(run.title, style.about(run) + unit, 2, 3.9, right=0.16)
    figure.set_dpi(DPI)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=[3, 2])
    shades = [PolyCollection([], fc=colour, alpha=0.4, lw=0) for colour in (ERODED, DEPOSITED)]
    for shade in shades:
        top.add_collection(shade, autolim=False)
    for axes, heights in ((top, u), (bottom, run.q)):  # limits for all times, so that the axes stay fixed
        axes.update_datalim([(x[0], heights.min()), (x[-1], heights.max())])
        axes.autoscale_view()
    start = style.draw_line(top, x, u[0], color=style.PALE, lw=0.8, ls=(0, (4, 2)), label="at the start")
    profile, slope = (axes.plot([], [], color=INK, lw=1.1)[0] for axes in (top, bottom))
    kinks = style.kinks_on(run, x, u)
    trails = [top.plot([], [], color=INK, lw=0.6)[0] for _ in kinks]
    dots = top.plot([], [], **style.DOT, ls="none", label="kink")
    patches = [Patch(fc=c, alpha=0.4, label=n) for c, n in ((ERODED, "eroded"), (DEPOSITED, "deposited"))]
    style.legend_above(figure, start + patches + (dots if kinks else []))
    height = figure.get_figheight()
    row = figure.subplotpars.top + (0.09 + 1.15 * style.LINE) / height
    texts = [figure.text(at / style.WIDTH, row, "", va="bottom") for at in (0.08, 2.25, 3.45)]
    top.set_ylabel(u_label)
    style.axis_of_q(bottom, run)
    style.axis_of_x(bottom, x, x_label)
    figure.align_ylabels([top, bottom])
    cells, volume = (run.units.x(run.x_cell), run.units.volume) if run.units else (run.x_cell, 1.0)

    def show(i: int) -> None:
        drawn, of_cell = style.visible(u[0], u[i], u[i] - u[0]), style.visible(run.q[i])
        there, first, now = x[drawn], u[0, drawn], u[i, drawn]
        profile.set_data(there, now)
        slope.set_data(cells[of_cell], run.q[i, of_cell])
        for shade, edge in zip(shades, (np.minimum(now, first), np.maximum(now, first)), strict=True):
            shade.set_verts([np.column_stack([np.append(there, there[::-1]), np.append(first, edge[::-1])])])
        for trail, (at, heights, index) in zip(trails, kinks, strict=True):
            trail.set_data(at[index <= i], heights[index <= i])
        dots[0].set_data(*style.dots_on(run, i, x, u[i]))
        areas = style.change_of(u[i], u[0], x)
        words = f"supplied {amount(volume * run.time[i])} of {amount(volume * run.time[-1])}", "eroded", "deposited"
        for text, word, area in zip(texts, words, ("", *map(amount, areas)), strict=True):
            text.set_text(f"{word} {area}")

    for i in (run.time.size - 1, 0):  # the letters avoid both
        show(i)
    style.letter_panels([top, bottom])
    return figure, [*shades, *trails, profile, *dots, slope, *texts], show


def _gif(images: list[Array], fps: float) -> bytes:
    """Return a GIF in which all images share one palette, repeated without end."""
    some = np.concatenate([images[i] for i in style.spread(len(images), 3)])
    palette = Image.fromarray(some).quantize(COLOURS)
    colours = np.array(palette.getpalette()).reshape(-1, 3)
    colours[colours.min(axis=1) > 248] = 255  # the background is white
    palette.putpalette(colours.ravel().tolist())
    pictures = [Image.fromarray(image).quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    lasts = [*[1000.0 / fps] * (len(images) - 1), 1000.0 * max(LAST, 1.0 / fps)]
    buffer = io.BytesIO()
    pictures[0].save(buffer, "gif", save_all=True, append_images=pictures[1:], duration=lasts, loop=0)
    return buffer.getvalue()


def _mp4(images: list[Array], fps: float, ffmpeg: str) -> bytes:
    """Return an MP4 by ffmpeg, with its default codec, in a colour format that every player supports."""
    rows, columns, _ = images[0].shape
    shown = [*images, *[images[-1]] * round(LAST * fps)]
    with tempfile.TemporaryDirectory() as folder, undone(lambda: shutil.rmtree(folder)):
        file = Path(folder) / "profile.mp4"
        form = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{columns}x{rows}", "-r", f"{fps:g}", "-i", "-"]
        command = [ffmpeg, "-loglevel", "error", *form, "-pix_fmt", "yuv420p", "-movflags", "+faststart", str(file)]
        done = subprocess.run(command, input=b"".join(map(np.ndarray.tobytes, shown)), capture_output=True)
        if done.returncode:
            reason = done.stderr.decode(errors="replace").strip().splitlines() or [f"exit code {done.returncode}"]
            raise RunError(f"ffmpeg could not write the MP4: {reason[-1]}; write a .gif instead", "a-moving-picture")
        return file.read_bytes()
