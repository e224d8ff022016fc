"""Pictures of the explanations, computed by the package.

``python -m docs.generate.pictures`` writes them to docs/images. They are committed, since the pages are read without a
build as well.
"""

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

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
    from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

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
            start, end = boxes[arrow.start], boxes[arrow.end]
            style = f"arc3,rad={arrow.bend}"
            axes.add_patch(
                FancyArrowPatch(
                    (start.x, start.y),
                    (end.x, end.y),
                    patchA=patches[arrow.start],
                    patchB=patches[arrow.end],
                    arrowstyle="-|>",
                    mutation_scale=11,
                    color="#455a64",
                    connectionstyle=style,
                )
            )
            # The middle of a bent arrow is aside of the straight line by half of its curvature.
            x, y = 0.5 * (start.x + end.x), 0.5 * (start.y + end.y)
            x, y = x + 0.5 * arrow.bend * (end.y - start.y), y - 0.5 * arrow.bend * (end.x - start.x)
            axes.text(x, y + 0.14, arrow.text, ha="center", va="center", fontsize=8, color="#455a64")
        figure.savefig(path, format="svg", metadata={"Date": None})


def stages(folder: Path) -> None:
    """Draw the five stages of a plant."""
    names = [
        ("drive", "current, voltage,\npower, duty"),
        ("heat", "convection,\nlatent heat"),
        ("material", "fractions,\nstrain"),
        ("mechanism", "load, spring,\nlimb"),
        ("sensor", "gain, offset,\nlag"),
    ]
    boxes = [Box(f"{name}\n{text}", 0.75 + 1.62 * k, 1.1) for k, (name, text) in enumerate(names)]
    carried = ("q [W/m³]", "T [degC]", "ε [1]", "x [mm]")
    arrows = [Arrow(k, k + 1, text) for k, text in enumerate(carried)]
    arrows += [Arrow(3, 2, "stress [MPa]", -0.75), Arrow(2, 0, "resistivity [ohm m]", 0.42)]
    draw_diagram(boxes, arrows, (8.0, 2.2), (1.06, 0.72), folder / "stages.svg")


def diagnosis_flow(folder: Path) -> None:
    """Draw the flow of a diagnosis."""
    names = [
        ("base fit", "training recording", 1.0, 3.6),
        ("score test", "all effects", 3.0, 3.6),
        ("forward selection", "selection recording", 5.0, 3.6),
        ("other laws", "Tanaka, Lagoudas, ...", 5.0, 2.3),
        ("cells and grains", "both recordings", 3.0, 2.3),
        ("facts, candidates", "share of the excess", 1.0, 2.3),
        ("holdout", "computed once", 1.0, 1.0),
        ("error budget", "each effect in turn", 3.0, 1.0),
        ("next experiment", "where rivals remain", 5.0, 1.0),
        ("nothing missing", "residual at the noise", 7.0, 3.6),
    ]
    boxes = [Box(f"{name}\n{text}", x, y, name == "nothing missing") for name, text, x, y in names]
    arrows = [Arrow(0, 1), Arrow(1, 2), Arrow(2, 3, ""), Arrow(3, 4), Arrow(4, 5), Arrow(5, 6), Arrow(6, 7)]
    arrows += [Arrow(7, 8), Arrow(0, 9, "residual at the noise", -0.28)]
    draw_diagram(boxes, arrows, (8.0, 4.7), (1.55, 0.66), folder / "diagnosis_flow.svg")


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
