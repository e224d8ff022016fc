"""Representation of a result in a notebook: its tables and sentences as HTML, a function of the document alone."""

from collections.abc import Callable, Mapping
from html import escape
from typing import Any

from smajax.report import comparison, summary, sweep, tuning
from smajax.report.diagnosis_page import effects_section, error_section
from smajax.report.diagnosis_summary import sentences
from smajax.report.pages import bullets, table
from smajax.report.run_pages import parameter_table, rmse_table
from smajax.report.summaries import summarise

Document = Mapping[str, Any]


def _fit_sections(doc: Document) -> list[str]:
    """Errors, verdicts, parameters and remarks of a fit."""
    bench = [_paragraph(sentence) for sentence in summary.bench_sentences(doc)]
    if doc["solver"]["code"] == "failed":
        return [*bench, _paragraph(summary.headline(doc))]
    if doc.get("failure"):
        bench.append(_paragraph(summary.capitalised(doc["failure"])))
    lead, verdicts = _paragraph(summary.headline(doc)), bullets(summary.verdicts(doc))
    notices = [_paragraph(notice) for notice in doc.get("notices", ())]
    return [*bench, lead, *notices, rmse_table(doc), verdicts, parameter_table(doc), bullets(summary.remarks(doc))]


def _diagnosis_sections(doc: Document) -> list[str]:
    """Sentences, errors before and after, and effects of a diagnosis."""
    return [*(_paragraph(sentence) for sentence in sentences(doc)), *error_section(doc), *effects_section(doc)]


def _comparison_sections(doc: Document) -> list[str]:
    """Ranking of a comparison."""
    ranking = table(comparison.MODEL_HEAD, comparison.model_rows(doc))
    return [_paragraph(doc["summary"]), ranking, bullets(comparison.notes(doc))]


def _tuning_sections(doc: Document) -> list[str]:
    """Gains and metrics before and after a tuning."""
    gains = table(("gain", "start", "tuned", "unit"), tuning.gain_rows(doc))
    metrics = table(tuning.stage_head(doc), tuning.metric_rows(doc))
    return [_paragraph(doc["summary"]), gains, metrics, bullets(tuning.left_out_lines(doc))]


def _sweep_sections(doc: Document) -> list[str]:
    """Best designs of a sweep."""
    head, *rows = sweep.best_columns(doc) or [()]
    return [_paragraph(doc["summary"]), table(head, rows) if rows else ""]


_SECTIONS: Mapping[str, Callable[[Document], list[str]]] = {
    "fit": _fit_sections,
    "diagnose": _diagnosis_sections,
    "compare": _comparison_sections,
    "tune": _tuning_sections,
    "sweep": _sweep_sections,
}


def notebook_html(command: str, document: Document) -> str:
    """Return tables and sentences of a result as HTML; all text from files is escaped.

    Args:
        command: The command.
        document: The content of its result document.
    """
    if command not in _SECTIONS:
        return f'<pre style="white-space: pre-wrap">{escape(summarise(command, document))}</pre>'
    return "".join(_SECTIONS[command](document))


def _paragraph(text: str) -> str:
    return f"<p>{escape(text)}</p>"
