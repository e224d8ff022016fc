"""Whether a fit explains its recordings at all: one that does not has no intervals, and is a failure."""

from collections.abc import Sequence

import numpy as np

from smajax.fitting.bench_checks import BenchFinding
from smajax.fitting.result import FitResult

# Residual in multiples of its noise floor from which the model is not that of the recording.
_FAR_FROM_NOISE = 100.0
# The same where a recording contradicts the rig: a wrong unit may be fitted by wrong parameters to 20 times the noise
# (a current of ten times the size in tests/unit/fitting/test_bench_checks.py).
_FAR_WITH_FINDINGS = 10.0
# Least share of the channel's range of such a residual: a recording almost without noise is far above its noise with a
# good model, too.
_MIN_RANGE_SHARE = 0.02
# Share of the channel's range from which a residual that far above the noise explains nothing, wherever the parameters
# are: a constant leaves a third of the range of a loop.
_LARGE_RANGE_SHARE = 0.2
# Parameters at bounds from which the search was pushed out of what the rig allows.
_SEVERAL = 2


def unusable_reason(result: FitResult, findings: Sequence[BenchFinding]) -> str:
    """Say why a fit is a failure although its search ended.

    It is one if its residual is 100 times the noise and several parameters are at their bounds or it is a fifth of the
    range, or 10 times the noise and a recording contradicts the rig.

    Args:
        result: The fit.
        findings: What the training recordings show about their bench.

    Returns:
        A sentence without its full stop; empty for a fit that is none.
    """
    train = [response for response in result.responses if response.role == "train"]
    far, ratios, large = _FAR_WITH_FINDINGS if findings else _FAR_FROM_NOISE, {}, False
    for channel, floor in result.noise_floor.items():
        rmse = result.rmse(channel, "train")
        measured = np.concatenate([response.recording.channels[channel] for response in train])
        extent = float(np.nanmax(measured) - np.nanmin(measured))
        if rmse is not None and floor > 0.0 and rmse >= max(far * floor, _MIN_RANGE_SHARE * extent):
            ratios[channel] = rmse / floor
            large |= rmse >= _LARGE_RANGE_SHARE * extent
    at_bound = [estimate.name for estimate in result.estimates if estimate.at_bound]
    if not ratios or (len(at_bound) < _SEVERAL and not findings and not large):
        return ""
    channel, ratio = max(ratios.items(), key=lambda item: item[1])
    residual = f"the fit failed: the residual of {channel} is {ratio:.0f} times its noise floor"
    if len(at_bound) >= _SEVERAL:
        residual += f" with {len(at_bound)} parameters at their bounds ({', '.join(at_bound)})"
    remedy = (
        "correct what the recording shows first" if findings else "check recording and rig, or the model is another"
    )
    return f"{residual}, so that its estimates mean nothing and have no intervals: {remedy}"
