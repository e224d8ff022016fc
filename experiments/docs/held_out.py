"""The contraction of the shipped wire on a recording that the fit has not used.

    python experiments/docs/held_out.py [--json FILE] [--out DIR]

It shows the measured and the modelled contraction, and below them their difference.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import ROOT, Row, arguments, finish, read_shipped
from experiments.common.charts import Chart, Curve, write_panels

import numpy as np

from smajax.fitting.fit import fit


def main() -> None:
    """Fit train.csv, predict holdout.csv, and draw both."""
    args = arguments(__doc__)
    rig, train = read_shipped("dead-weight")
    _, holdout = read_shipped("dead-weight", "holdout")
    result = fit(rig.plant, [train], rig.fit, holdout=[holdout], interpolation=rig.interpolation)
    response = result.responses[1]
    measured, model = (1e3 * np.asarray(values["displacement"]) for values in (holdout.channels, response.model))
    part = slice(0, None, 5)
    curves = [
        Curve("measured", holdout.time[part], measured[part]),
        Curve("model", holdout.time[part], model[part], dashed=True),
    ]
    residual = [Curve("residual", holdout.time[part], (measured - model)[part])]
    charts = [
        Chart("Held-out recording of a wire lifting 0.2 kg", "time [s]", "contraction [mm]", curves),
        Chart("Residual", "time [s]", "measured - model [mm]", residual),
    ]
    folder = args.out or ROOT / "docs" / "images"
    folder.mkdir(parents=True, exist_ok=True)
    write_panels(charts, folder / "held_out.svg")
    rmse, noise = result.rmse("displacement", "holdout") or np.nan, result.noise_floor["displacement"]
    rows = [
        Row(
            "held-out RMSE over the noise",
            "-",
            f"{1e3 * rmse:.4f} mm over {1e3 * noise:.4f} mm",
            None,
            {"rmse_m": rmse, "noise_m": noise},
        )
    ]
    finish(rows, args)


if __name__ == "__main__":
    main()
