"""The main figure of each command's result, a function of its document and of its predictions."""

from __future__ import annotations  # plotly loads its classes when a figure is made

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go

from smajax.report.comparison import series_by_model
from smajax.report.prediction import Series, split_label
from smajax.report.properties_page import cycles_picture
from smajax.report.run_pages import simulated_channels
from smajax.report.sweep import design_picture
from smajax.report.time_figures import comparison_picture, response_picture, time_picture

Document = Mapping[str, Any]


def figure_of_fit(document: Document, series: Sequence[Series]) -> go.Figure:
    """Show measurement, model and residual of the first recording, with the noise band and the inputs.

    Args:
        document: The content of fit.json.
        series: The recordings with their predictions.
    """
    noise = {channel: entry["value"] for channel, entry in document["noise_floor"].items()}
    return time_picture(series[0], document["observed"], document["inputs"], noise).standalone()


def figure_of_diagnosis(document: Document, series: Sequence[Series]) -> go.Figure:
    """Show measurement and models before and after, and their residuals, of the holdout.

    Args:
        document: The content of diagnosis.json.
        series: The predictions before and after, named "RECORDING (before)" and "RECORDING (after)".
    """
    shown = [s for s in series if s.role.startswith("holdout")] or list(series)
    fits = {split_label(s.name)[1]: s for s in shown}
    return comparison_picture(fits, next(iter(document["rmse"])), "holdout").standalone()


def figure_of_comparison(document: Document, series: Sequence[Series]) -> go.Figure:
    """Show the predictions of the holdout by all models, best first, and their residuals.

    Args:
        document: The content of compare.json.
        series: The predictions, named "RECORDING (MODEL)".
    """
    return comparison_picture(series_by_model(document, series, "holdout"), document["channel"], "holdout").standalone()


def figure_of_tuning(document: Document, series: Sequence[Series]) -> go.Figure:
    """Show the rollouts with start and tuned gains, and the reference.

    Args:
        document: The content of tune.json.
        series: The rollouts with start and tuned gains.
    """
    return response_picture(series, document["channel"]).standalone()


def figure_of_sweep(document: Document, columns: Mapping[str, np.ndarray]) -> go.Figure:
    """Show all designs over two metrics with the Pareto front; across all axes if there is one metric only.

    Args:
        document: The content of sweep.json.
        columns: Columns of the sweep's table by name, shape ``(m,)`` each.
    """
    return design_picture(document, columns).standalone()


def figure_of_simulation(document: Document, series: Sequence[Series]) -> go.Figure:
    """Show the simulated channels that the rig observes, the residual of those that were measured, and the inputs.

    Args:
        document: The content of run.json.
        series: The recording with the simulated channels.
    """
    observed = simulated_channels(document, series[0])
    return time_picture(series[0], observed, document["inputs"], {}).standalone()


def figure_of_properties(document: Document, series: Sequence[Series]) -> go.Figure:
    """Show strain against temperature, and the mean transformation temperatures with their 95 % intervals.

    Args:
        document: The content of properties.json.
        series: Recordings with the measured channels temperature and strain.
    """
    return cycles_picture(document, series).standalone()


# Function of each command that makes its main figure from the content of its document and its predictions; a sweep has
# the columns of its table in their place, and a fit and a simulation show the first of the recordings.
FIGURES: Mapping[str, Callable[[Document, Any], go.Figure]] = {
    "fit": figure_of_fit,
    "diagnose": figure_of_diagnosis,
    "compare": figure_of_comparison,
    "tune": figure_of_tuning,
    "sweep": figure_of_sweep,
    "properties": figure_of_properties,
    "simulate": figure_of_simulation,
}
