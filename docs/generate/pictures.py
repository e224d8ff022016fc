"""Pictures of the explanations, computed by the package.

``python -m docs.generate.pictures`` writes them to docs/images. They are committed, since the pages are read without a
build as well.
"""

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from experiments.common.charts import STYLE, Chart, Curve, write_panels, write_svg

import numpy as np

import smajax as sma
from smajax.recordings.datasets import data_path

IMAGES = Path(__file__).resolve().parents[1] / "images"
MPA = 1e-6  # MPa per Pa


class Box(NamedTuple):
    """A box of a diagram.

    Attributes:
        text: Its text; the first line is bold.
        x: Place of its middle, in inches from the left.
        y: Place of its middle, in inches from below.
        is_result: Whether it is a result and not a step.
    """

    text: str
    x: float
    y: float
    is_result: bool = False


class Arrow(NamedTuple):
    """An arrow from one box to another.

    Attributes:
        start: Index of the box where it begins.
        end: Index of the box where it ends.
        text: What it carries.
        bend: Curvature; 0 for a straight one.
    """

    start: int
    end: int
    text: str = ""
    bend: float = 0.0


def draw_diagram(
    boxes: Sequence[Box], arrows: Sequence[Arrow], size: tuple[float, float], box: tuple[float, float], path: Path
) -> None:
    """Write a diagram of boxes and arrows as an SVG file.

    Args:
        boxes: The boxes.
        arrows: The arrows between them.
        size: Width and height of the picture, inches.
        box: Width and height of a box, inches.
        path: The file.
    """
    import matplotlib
    from matplotlib.figure import Figure
    from matplotlib.patches import FancyBboxPatch

    with matplotlib.rc_context({**STYLE, "font.size": 9}):
        figure = Figure(figsize=size)
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        axes.set(xlim=(0.0, size[0]), ylim=(0.0, size[1]))
        axes.axis("off")
        patches = []
        for b in boxes:
            corner = b.x - 0.5 * box[0], b.y - 0.5 * box[1]
            colour = "#e8f1ec" if b.is_result else "#e6eef5"
            patches.append(FancyBboxPatch(corner, *box, "round,pad=0,rounding_size=0.08", fc=colour, ec="#607d8b"))
            axes.add_patch(patches[-1])
            head, _, rest = b.text.partition("\n")
            lines = rest.count("\n") + 1 if rest else 0
            axes.text(b.x, b.y + 0.085 * lines, head, ha="center", va="center", weight="bold")
            axes.text(b.x, b.y - 0.09, rest, ha="center", va="center", fontsize=8)
        for arrow in arrows:
            _draw_arrow(axes, arrow, boxes, patches)
        figure.savefig(path, format="svg", metadata={"Date": None})


def _draw_arrow(axes: Any, arrow: Arrow, boxes: Sequence[Box], patches: Sequence[Any]) -> None:
    """Draw an arrow with its text above it, or next to it where it goes up or down."""
    from matplotlib.patches import FancyArrowPatch

    start, end = boxes[arrow.start], boxes[arrow.end]
    axes.add_patch(
        FancyArrowPatch(
            (start.x, start.y),
            (end.x, end.y),
            patchA=patches[arrow.start],
            patchB=patches[arrow.end],
            arrowstyle="-|>",
            mutation_scale=11,
            color="#455a64",
            connectionstyle=f"arc3,rad={arrow.bend}",
        )
    )
    # The middle of a bent arrow is aside of the straight line by half of its curvature.
    x, y = 0.5 * (start.x + end.x), 0.5 * (start.y + end.y)
    x, y = x + 0.5 * arrow.bend * (end.y - start.y), y - 0.5 * arrow.bend * (end.x - start.x)
    upright = start.x == end.x
    side = "center" if not upright else "right" if x < start.x else "left"
    x, y = x + {"center": 0.0, "right": -0.06, "left": 0.08}[side], y + (0.0 if upright else 0.14)
    axes.text(x, y, arrow.text, ha=side, va="center", fontsize=8, color="#455a64")


# What the five stages do, and what each hands to the next.
_STAGES = (
    ("drive", "current, voltage,\npower, duty"),
    ("heat", "convection,\nlatent heat"),
    ("material", "fractions,\nstrain"),
    ("mechanism", "load, spring,\nlimb"),
    ("sensor", "gain, offset,\nlag"),
)
_CARRIED = ("q [W/m³]", "T [degC]", "ε [1]", "x [mm]")


def stages(folder: Path) -> None:
    """Draw the five stages of a plant, from left to right, and from top to bottom for narrow screens."""
    boxes = [Box(f"{name}\n{text}", 0.75 + 1.62 * k, 1.1) for k, (name, text) in enumerate(_STAGES)]
    forward = [Arrow(k, k + 1, text) for k, text in enumerate(_CARRIED)]
    back = [Arrow(3, 2, "stress [MPa]", -0.75), Arrow(2, 0, "resistivity [ohm m]", 0.42)]
    draw_diagram(boxes, forward + back, (8.0, 2.2), (1.06, 0.72), folder / "stages.svg")
    boxes = [Box(f"{name}\n{text}", 2.25, 4.85 - 1.1 * k) for k, (name, text) in enumerate(_STAGES)]
    back = [Arrow(3, 2, "stress\n[MPa]", -1.75), Arrow(2, 0, "resistivity\n[ohm m]", -1.05)]
    draw_diagram(boxes, forward + back, (3.6, 5.3), (1.3, 0.72), folder / "stages-narrow.svg")


# The steps of a diagnosis; the last one is where it may end.
_STEPS = (
    ("base fit", "training recording"),
    ("score test", "all effects"),
    ("forward selection", "selection recording"),
    ("other laws", "Tanaka, Lagoudas, ..."),
    ("cells and grains", "both recordings"),
    ("facts, candidates", "share of the excess"),
    ("holdout", "computed once"),
    ("error budget", "each effect in turn"),
    ("next experiment", "where rivals remain"),
    ("nothing missing", "residual at the noise"),
)


def diagnosis_flow(folder: Path) -> None:
    """Draw the flow of a diagnosis, in three columns, and in two for narrow screens."""
    wide = [(1.0, 3.6), (3.0, 3.6), (5.0, 3.6), (5.0, 2.3), (3.0, 2.3), (1.0, 2.3), (1.0, 1.0), (3.0, 1.0), (5.0, 1.0)]
    wide += [(7.0, 3.6)]
    left, right = 0.88, 2.72
    rows = [(left, 4.6), (left, 3.6), (right, 3.6), (right, 2.6), (left, 2.6), (left, 1.6), (right, 1.6), (right, 0.6)]
    narrow = [*rows, (left, 0.6), (right, 4.6)]
    steps = [Arrow(k, k + 1) for k in range(len(_STEPS) - 2)]
    for places, size, end, name in (
        (wide, (8.0, 4.7), Arrow(0, 9, "residual at the noise", -0.28), "diagnosis_flow"),
        (narrow, (3.6, 5.1), Arrow(0, 9), "diagnosis_flow-narrow"),
    ):
        boxes = [
            Box(f"{head}\n{text}", *place, head == "nothing missing")
            for (head, text), place in zip(_STEPS, places, strict=True)
        ]
        draw_diagram(boxes, [*steps, end], size, (1.55, 0.66), folder / f"{name}.svg")


def phase_diagram(folder: Path) -> None:
    """Draw the transformation lines of Brinson's law, with the parameters of the shipped wire."""
    law = sma.read_rig(data_path("recordings", "dead-weight", "rig.toml")).plant.material
    top = 250e6
    curves = []
    for name, start in (("A_s", law.austenite_start), ("A_f", law.austenite_finish)):
        temperature = np.array([0.0, top]) / float(law.clausius_clapeyron_austenite) + float(start)
        curves.append(Curve(f"austenite, {name}", temperature, np.array([0.0, top * MPA])))
    start = float(law.martensite_start)
    for name, stress in (("start", law.detwinning_start_stress), ("finish", law.detwinning_finish_stress)):
        rise = (top - float(stress)) / float(law.clausius_clapeyron_martensite)
        temperature = np.array([0.0, start, start + rise])
        values = MPA * np.array([float(stress), float(stress), top])
        curves.append(Curve(f"detwinned martensite, {name}", temperature, values, dashed=True))
    for name, value in (("M_s", law.martensite_start), ("M_f", law.martensite_finish)):
        values = np.array([0.0, float(law.detwinning_start_stress) * MPA])
        curves.append(Curve(f"twinned martensite, {name}", np.full(2, float(value)), values, dashed=True))
    title = "Where the phases transform (shipped wire)"
    write_svg(Chart(title, "temperature [degC]", "stress [MPa]", curves), folder / "phase_diagram.svg")


def partial_loop(folder: Path) -> None:
    """Draw a full and a partial loop of a wire that lifts a constant load, heated and cooled slowly."""
    plant = sma.read_rig(data_path("recordings", "isobaric", "rig.toml")).plant
    curves = []
    # The first cycle forms the martensite under the load; the second one is shown.
    for name, peak in (("full", 130.0), ("partial", 92.0)):
        turns = (20.0, 130.0, 20.0, peak, 20.0)
        temperature = np.concatenate([np.linspace(a, b, 200) for a, b in itertools.pairwise(turns)])
        columns = {"temperature [degC]": temperature, "stress [MPa]": np.full(len(temperature), 150.0)}
        recording = sma.read_recording(columns, clock=False, name=name)
        strain = 100 * np.asarray(sma.simulate(plant, recording).channels["strain"])
        curves.append(Curve(f"{name} loop", temperature[400:], strain[400:], dashed=name == "partial"))
    title = "Loops under 150 MPa, heated and cooled slowly"
    write_svg(Chart(title, "temperature [degC]", "strain [%]", curves), folder / "partial_loop.svg")


def rollout(folder: Path) -> None:
    """Draw a closed loop of the shipped wire with the start gains of the shipped controller."""
    rig = sma.read_rig(data_path("recordings", "dead-weight", "rig.toml"))
    pid = sma.controllers.PID(kp=30.0, ki=10.0, kd=0.5, filter_time=0.05, lower=0.0, upper=0.5, period=0.02)
    levels = np.repeat([4e-3, 6e-3, 2e-3], 1000)
    run = sma.rollout(rig.plant, sma.ClosedLoop(pid, channel="displacement"), levels)
    time = 0.02 * np.arange(len(levels))
    amperes = np.asarray(run.command[:, 0])
    displacement = 1e3 * np.asarray(run.channels["displacement"])
    motion = Chart(
        "A wire follows a staircase",
        "time [s]",
        "displacement [mm]",
        [Curve("displacement", time, displacement), Curve("reference", time, 1e3 * levels, steps=True, dashed=True)],
    )
    current = Chart("Command of the PID", "time [s]", "current [A]", [Curve("current", time, amperes)])
    write_panels([motion, current], folder / "rollout.svg")


def main(folder: Path = IMAGES) -> None:
    """Write all pictures."""
    for draw in (stages, diagnosis_flow, phase_diagram, partial_loop, rollout):
        draw(folder)


if __name__ == "__main__":
    main()
