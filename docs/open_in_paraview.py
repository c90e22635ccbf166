"""Lay out a result of hjprofile in ParaView: the profile with its kinks, to be played, and below it its whole history.

    pvpython docs/open_in_paraview.py results/hillslope hillslope.png    a picture halfway
    pvpython docs/open_in_paraview.py results/hillslope hillslope.avi    a film of all saved times

In ParaView itself open vtk/profile.pvd first and run this file as a macro.
"""

import json
import sys
from pathlib import Path

from paraview import simple as pv


def view_of(layout, place, vertical, left, right, low, high):
    """A 2D view of a box a quarter as high as wide, whatever it holds: so one x stands below the other."""
    width, stretch = right - left, 0.25 * (right - left) / ((high - low) or 1.0)
    view = pv.CreateView("RenderView", InteractionMode="2D", OrientationAxesVisibility=0)
    pv.AssignViewToLayout(view, layout, place)
    middle = [left + 0.53 * width, 0.5 * (low + high) * stretch]
    view.CameraFocalPoint, view.CameraPosition = [*middle, 0.0], [*middle, width]
    view.CameraParallelProjection, view.CameraParallelScale = 1, 0.19 * width
    grid = view.AxesGrid
    grid.Visibility, grid.AxesToLabel, grid.XTitle, grid.YTitle = 1, 3, "x", vertical
    grid.DataScale = [1.0, stretch, 1.0]  # the numbers on the axes stay those of the data
    grid.UseCustomBounds, grid.CustomBounds = 1, [left, right, low * stretch, high * stretch, 0.0, 0.0]
    return view


def show(source, view, kind, array, t=0.0):
    """Show a source in its view; returns the colours of its array, over all times. At the time t it has the array."""
    display = pv.Show(source, view)
    source.UpdatePipeline(t)
    display.Scale = view.AxesGrid.DataScale
    display.LineWidth, display.PointSize, display.RenderPointsAsSpheres = 4.0, 12.0, 1
    display.Ambient, display.Diffuse = 1.0, 0.0  # colours as in the bar, not shaded
    pv.ColorBy(display, (kind, array))
    display.RescaleTransferFunctionToDataRangeOverTime()
    display.SetScalarBarVisibility(view, True)
    colours = pv.GetColorTransferFunction(array)
    colours.AutomaticRescaleRangeMode = "Never"
    pv.GetScalarBar(colours, view).RangeLabelFormat = "%.3g"
    return colours


def lay_out(folder):
    """The files of a folder `vtk` in two views; returns their layout."""
    account = folder.parent / "summary.json"  # there is none beside what `hjprofile export --out` wrote
    title = json.loads(account.read_text(encoding="utf-8"))["title"] if account.exists() else folder.name
    files = ("profile.pvd", "kinks.pvd", "sheet.vtr")
    profile, kinks, sheet = (pv.OpenDataFile(str(folder / f), registrationName=f) for f in files)
    sheet.UpdatePipeline()
    left, right, begin, end, *_ = sheet.GetDataInformation().GetBounds()
    layout = pv.CreateLayout(title)
    layout.SplitVertical(0, 0.5)
    above = view_of(layout, 1, "u", left, right, *sheet.PointData["u"].GetRange())
    below = view_of(layout, 2, "t", left, right, begin, end)
    pv.GetAnimationScene().UpdateAnimationUsingDataTimeSteps()  # play shows each saved time, and no other
    for t in profile.TimestepValues:
        kinks.UpdatePipeline(t)
        if kinks.PointData.GetArray("jump") is not None:  # ParaView knows no arrays of a time without kinks
            show(kinks, above, "POINTS", "jump", t).ApplyPreset("Viridis (matplotlib)", True)
            break
    show(sheet, below, "POINTS", "q")
    colours = show(profile, above, "CELLS", "q")
    largest = max(abs(colours.RGBPoints[0]), abs(colours.RGBPoints[-4])) or 1.0
    if (folder.parent / "vertical_steps.csv").exists():
        largest = min(largest, 5.0)  # else a vertical step leaves no colours for the rest
    colours.RescaleTransferFunction(-largest, largest)  # pale is critical, red erodes, blue fills
    now = pv.AnnotateTimeFilter(profile, Format=title.replace("{", "{{").replace("}", "}}") + ",  t = {time:.4g}")
    pv.Show(now, above)
    pv.SetActiveView(above)
    pv.SetActiveSource(profile)
    return layout


if len(sys.argv) == 3:
    result, picture = Path(sys.argv[1]), sys.argv[2]
    layout = lay_out(result / "vtk" if (result / "vtk").is_dir() else result)
    layout.SetSize(1400, 900)
    if picture.endswith(".png"):
        times = pv.GetTimeKeeper().TimestepValues
        pv.GetAnimationScene().AnimationTime = times[len(times) // 2]
        pv.SaveScreenshot(picture, layout)
    else:
        pv.SaveAnimation(picture, layout)
elif hasattr(pv.GetActiveSource(), "FileName"):
    lay_out(Path(str(pv.GetActiveSource().FileName)).parent)
else:
    print("Open vtk/profile.pvd and select it first; or give pvpython a result folder and the name of a picture")
