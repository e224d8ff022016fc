"""Charts of the experiments: an SVG with its texts, the same for the same chart, and a page."""

from experiments.common.charts import Chart, Curve, draw

import numpy as np


def test_a_chart_has_its_texts_and_is_the_same_file_twice(tmp_path):
    x = np.linspace(1.0, 100.0, 30)
    curves = [
        Curve("measured", x, x**2),
        Curve("model & error < 1", x, 1.1 * x**2, dashed=True),
        Curve("held", x, x, True),
    ]
    chart = Chart("A title", "time [s]", "error [mm]", curves, log_x=True, log_y=True)
    paths = draw(chart, tmp_path, "figure")
    assert [path.name for path in paths] == ["figure.svg", "figure.html"]
    text = paths[0].read_text("utf-8")
    for word in ("A title", "time [s]", "error [mm]", "measured", "model &amp; error &lt; 1", "#0072b2", "#009e73"):
        assert word in text
    assert "plotly" in paths[1].read_text("utf-8")
    draw(chart, tmp_path, "again")
    assert (tmp_path / "again.svg").read_text("utf-8") == text
