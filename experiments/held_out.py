"""The README's picture: the shipped wire's contraction on the recording that the fit has not seen, measured and modelled, and the rest."""

from __future__ import annotations

import numpy as np
from _common import ROOT, Row, arguments, finish, shipped
from _figures import Chart, Curve, draw

from smajax.fit.fit import fit


def main() -> None:
    """Fits train.csv, predicts holdout.csv, draws both."""
    args = arguments(__doc__)
    rig, train = shipped("dead-weight")
    _, held = shipped("dead-weight", "holdout")
    result = fit(rig.plant, [train], rig.fit, holdout=[held], interpolation=rig.interpolation)
    response = result.responses[1]
    measured, model = (1e3 * np.asarray(values["displacement"]) for values in (held.channels, response.model))
    part = slice(0, None, 5)
    curves = [
        Curve("measured", held.time[part], measured[part]),
        Curve("model", held.time[part], model[part], dashed=True),
        Curve("50 x (measured - model)", held.time[part], 50 * (measured - model)[part]),
    ]
    folder = args.out or ROOT / "experiments" / "figures"
    folder.mkdir(parents=True, exist_ok=True)
    draw(Chart("Held-out recording of a wire lifting 0.2 kg", "time [s]", "contraction [mm]", curves), folder, "held_out")
    (folder / "held_out.html").unlink()
    left, floor = result.rmse("displacement", "holdout") or np.nan, result.noise_floor["displacement"]
    rows = [
        Row("held-out RMSE over the noise", "-", f"{1e3 * left:.4f} mm over {1e3 * floor:.4f} mm", None, {"rmse_m": left, "noise_m": floor})
    ]
    finish("held_out", rows, args)


if __name__ == "__main__":
    main()
