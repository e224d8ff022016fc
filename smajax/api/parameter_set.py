"""The parameter set that a fit writes, fit.toml."""

from collections.abc import Sequence

from smajax import __version__
from smajax.files.parameter_sets import Entry, parameters_text
from smajax.fitting.result import FitResult
from smajax.recordings.recording import Recording


def parameter_set(result: FitResult, train: Sequence[Recording]) -> str:
    """Return the text of fit.toml: the estimates with intervals, bounds and source.

    Args:
        result: The fit.
        train: The training recordings.
    """
    source = "fit to " + ", ".join(f"{r.name} (sha256 {r.sha256})" for r in train)
    entries = {}
    for estimate in result.estimates:
        low, high = estimate.bounds
        lower95, upper95 = estimate.lower95, estimate.upper95
        entries[estimate.name] = Entry(
            value=min(max(estimate.estimate, low), high),
            unit=estimate.unit,
            lower=low,
            upper=high,
            source=source,
            interval95=(lower95, upper95) if lower95 is not None and upper95 is not None else None,
            free=True,
            at_bound=estimate.at_bound,
        )
    fit_table = {
        "smajax": __version__,
        "result": result.status.name,
        "seed": result.seed,
        "recordings": [r.name for r in train],
    }
    return parameters_text(entries, {"title": "parameters estimated by smajax fit", "fit": fit_table})
