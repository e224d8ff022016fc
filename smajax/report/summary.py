"""Summary of a fit in sentences and tables, for a terminal and the head of the report.

It needs the document ``fit.json`` only, so an old result folder can be summarised without its model. The module also
has the text table that all summaries use.
"""

import enum
import math
from collections.abc import Mapping, Sequence
from textwrap import wrap
from typing import Any, NamedTuple

from smajax.files.documents import is_undetermined
from smajax.report.topics import NOT_CONVERGED, explained, fit_topics
from smajax.units import example_of, from_si

Document = Mapping[str, Any]

# Rise of the cost at the ends of a 95 % interval: the 0.95 quantile of the chi-squared distribution with one degree of
# freedom.
RISE_95 = 3.841
# Width of the text in columns of a terminal.
_WIDTH = 110
# Ratios of residual to noise floor up to which the residual counts as noise, or as little more: the noise floor itself
# is an estimate with an error of some per cent. Chosen by trial.
_AT_NOISE = 1.15
_NEAR_NOISE = 2.0
# Ratio of holdout error to training error above which the summary mentions it.
_WORSE_HOLDOUT = 1.2
# Change of the model by halved time steps, as a share of the noise floor, above which the summary mentions it.
_COARSE_STEPS = 0.1
# Remaining effect of a joint change of collinear parameters that is shown as "almost nothing".
_ALMOST_NOTHING = 5e-5
# Powers of ten beyond which numbers are shown with an exponent.
_LARGE_EXPONENT = 7
_SMALL_EXPONENT = -4


class ResidualCode(enum.StrEnum):
    """Size of a channel's residual next to its noise floor."""

    noise = "noise"
    near_noise = "near-noise"
    not_converged = "not-converged"
    unexplained = "unexplained"


class ResidualVerdict(NamedTuple):
    """Residual of an observed channel next to its noise floor and to the holdout.

    Attributes:
        channel: The channel.
        code: Size of the residual.
        ratio: RMSE of the fitted recordings over the noise floor.
        holdout_ratio: RMSE of the holdout over that of the fitted recordings; ``None`` without a holdout.
    """

    channel: str
    code: ResidualCode
    ratio: float
    holdout_ratio: float | None

    @property
    def has_worse_holdout(self) -> bool:
        """Whether the holdout is predicted worse than the fitted recordings."""
        return self.holdout_ratio is not None and self.holdout_ratio > _WORSE_HOLDOUT

    @property
    def is_bad(self) -> bool:
        """Whether the model lacks something or predicts the holdout badly."""
        return self.code is ResidualCode.unexplained or self.has_worse_holdout


def text(doc: Document, folder: str = "") -> str:
    """Format the summary of a fit for a terminal, without colours, in 120 columns where the names allow it.

    Args:
        doc: The document fit.json.
        folder: The result folder, which the last line names; empty for none.
    """
    lines = [line for sentence in bench_sentences(doc) for line in [*wrap(sentence, _WIDTH), ""]]
    if doc.get("failure"):  # absent in documents of earlier versions
        lines += [*wrap(capitalised(doc["failure"]), _WIDTH), ""]
    lines += [*wrap(headline(doc), _WIDTH), ""]
    for notice in doc.get("notices", ()):
        lines += [*wrap(notice, _WIDTH), ""]
    if doc["solver"]["code"] != "failed":
        lines += table([("channel", "RMSE train", "holdout", "noise floor", "train / floor"), *rmse_rows(doc)])
        lines += [*(line for s in verdicts(doc) for line in wrap(s, _WIDTH)), ""]
        rows = [
            (name, nominal, estimate, f"{low} .. {high}" if low != "-" else "none", unit, note)
            for name, nominal, estimate, low, high, unit, note in parameter_rows(doc)
        ]
        lines += table([("parameter", "nominal", "estimate", "95 % interval", "unit", ""), *rows], right=(1, 2, 3))
        lines += [line for sentence in temperature_sentences(doc) for line in wrap(sentence, _WIDTH)]
    for name, profile in doc.get("profiles", {}).items():
        entry = doc["parameters"][name]
        ends = profile["lower95"], profile["upper95"]
        _, low, high, unit = readable(entry["estimate"], *ends, unit=entry["unit"], shown=entry.get("file_unit"))
        lines.append(f"Profile likelihood of {name}: {low} .. {high} {unit} (95 %).")
    sentences = remarks(doc)
    if sentences:
        lines += [
            "",
            *(line for s in sentences for line in wrap(s, _WIDTH, initial_indent="- ", subsequent_indent="  ")),
        ]
    is_bad = any(verdict.is_bad for verdict in residual_verdicts(doc))
    lines += explained(fit_topics(doc, is_bad))
    if folder:
        lines += ["", f"Results: {folder}"]
    return "\n".join(line.rstrip() for line in lines)


def bench_sentences(doc: Document) -> list[str]:
    """List sentences about what the recordings show about their bench, which come before any number."""
    return [entry["text"] for entry in doc.get("bench", ())]  # absent in documents of earlier versions


def capitalised(text: str) -> str:
    """Return a text as a sentence with a capital and a full stop."""
    return f"{text[:1].upper()}{text[1:]}."


def headline(doc: Document) -> str:
    """Say in one sentence which parameters were fitted to which recordings, and whether the fit converged."""
    solver = doc["solver"]
    trained = [r for r in doc["recordings"] if r["role"] == "train"]
    free = sum(p["free"] for p in doc["parameters"].values())
    what = f"{free} parameter{'s' * (free != 1)} of {doc['rig']} ({doc['model']})"
    data = f"{_join_names([r['name'] for r in trained])} ({sum(r['rows'] for r in trained):,} rows)"
    if solver["code"] == "failed":
        return f"Could not fit {what} to {data}: {solver['text']}."
    effort = f"{solver['steps']} step{'s' * (solver['steps'] != 1)}, {solver['wall_s']:.1f} s"
    ending = "converged" if solver["code"] == "converged" else solver["text"]
    return f"Fitted {what} to {data}: {ending} ({effort})."


def residual_verdicts(doc: Document) -> list[ResidualVerdict]:
    """Compare the residual of each observed channel with its noise floor and with the holdout."""
    comparisons = []
    for channel, rmse in doc["rmse"].items():
        floor, train, holdout = doc["noise_floor"][channel]["value"], rmse["train"], rmse["holdout"]
        if train is None or not floor:
            continue
        ratio, code = train / floor, ResidualCode.unexplained
        if ratio <= _AT_NOISE:
            code = ResidualCode.noise
        elif ratio <= _NEAR_NOISE:
            code = ResidualCode.near_noise
        elif doc["solver"]["code"] in NOT_CONVERGED:
            code = ResidualCode.not_converged
        # A fit without a residual has no ratio; any error on the holdout is then worse.
        worse = (holdout / train if train else math.inf if holdout else 1.0) if holdout is not None else None
        comparisons.append(ResidualVerdict(channel, code, ratio, worse))
    return comparisons


def verdicts(doc: Document) -> list[str]:
    """Word ``residual_verdicts``, one sentence each."""
    return [_verdict_sentence(verdict) for verdict in residual_verdicts(doc)]


def _verdict_sentence(verdict: ResidualVerdict) -> str:
    residual, ratio, worse = f"The residual of {verdict.channel}", verdict.ratio, verdict.holdout_ratio
    sentence = {
        ResidualCode.noise: f"{residual} is at its noise floor: the model explains all but the noise",
        ResidualCode.near_noise: (
            f"{residual} is {ratio:.2f} times its noise floor: the model leaves a small part unexplained"
        ),
        ResidualCode.not_converged: (
            f"{residual} is {ratio:.3g} times its noise floor, and the fit had not converged yet"
        ),
        ResidualCode.unexplained: (
            f"{residual} is {ratio:.3g} times its noise floor: the model lacks something, which smajax diagnose "
            "looks for, or the minimum is not the global one, which more starts may find"
        ),
    }[verdict.code]
    if verdict.has_worse_holdout and worse is not None:
        return f"{sentence}; the holdout is predicted {round(worse, 1):g} times worse than the fitted recordings."
    return f"{sentence}."


def rmse_rows(doc: Document) -> list[tuple[str, ...]]:
    """Return table rows: channel, RMSE of train and holdout, noise floor, train over floor; a dash for no value."""
    rows = []
    for channel, rmse in doc["rmse"].items():
        floor = doc["noise_floor"][channel]["value"]
        ratio = _three_digits(rmse["train"] / floor) if floor and rmse["train"] is not None else "-"
        values = (rmse["train"], rmse["holdout"], floor)
        cells = [f"{_three_digits(v)} {rmse['unit']}" if v is not None else "-" for v in values]
        rows.append((channel, *cells, ratio))
    return rows


def parameter_rows(doc: Document) -> list[tuple[str, ...]]:
    """Return table rows of the free parameters: name, nominal, estimate, ends of the interval, unit, and remark.

    Units are those of the rig file, else the usual ones.
    """
    rows = []
    for name, entry in doc["parameters"].items():
        if not entry["free"]:
            continue
        units = {"unit": entry["unit"], "shown": entry.get("file_unit")}  # absent in documents of earlier versions
        nominal = readable(entry.get("nominal"), None, None, **units)[0]
        if is_undetermined(entry) and not doc.get("failure"):
            estimate, _, _, unit = readable(entry["estimate"], None, None, **units)
            rows.append((name, nominal, estimate, "-", "-", unit, "not determined"))
            continue
        cells = readable(entry["estimate"], entry["lower95"], entry["upper95"], **units)
        rows.append((name, nominal, *cells, "at its bound" if entry["at_bound"] else ""))
    return rows


_TEMPERATURES = {
    "material.martensite_finish": "M_f",
    "material.martensite_start": "M_s",
    "material.austenite_start": "A_s",
    "material.austenite_finish": "A_f",
}


def temperature_sentences(doc: Document) -> list[str]:
    """Return a sentence on the transformation temperatures that result from the estimates; none without them."""
    values = doc.get("transformation_temperatures") or {}  # absent in documents of earlier versions
    shown = [f"{sign} {values[n]:.1f}" for n, sign in _TEMPERATURES.items() if values.get(n) is not None]
    return [f"Transformation temperatures at zero stress that result: {', '.join(shown)} degC."] if shown else []


def readable(
    estimate: float | None, lower: float | None, upper: float | None, *, unit: str, shown: str | None = None
) -> tuple[str, str, str, str]:
    """Format an estimate and its interval to two digits of the half width of the interval.

    Args:
        estimate: The estimate, in its internal unit.
        lower: Lower end of its 95 % interval; ``None`` for none.
        upper: Upper end; ``None`` for none.
        unit: Internal unit of all three.
        shown: Unit in which they are shown; the usual one by default.

    Returns:
        The three numbers as text, a dash for ``None``, and the unit in which they are shown.
    """
    shown = shown or ("" if unit == "1" else example_of(unit).split(maxsplit=1)[1])
    value, low, high = (
        None if v is None else (from_si(v, shown, unit) if shown else v) for v in (estimate, lower, upper)
    )
    half = (high - low) / 2 if low is not None and high is not None else 0.0
    return _round_to(value, half), _round_to(low, half), _round_to(high, half), shown


def remarks(doc: Document) -> list[str]:
    """List sentences about noisy inputs, collinear parameters, bounds, starts, steps, repairs, and warnings."""
    return [
        *_noise_sentences(doc),
        *_undetermined_sentences(doc),
        *collinear_sentences(doc),
        *_bound_sentences(doc),
        *_start_sentences(doc),
        *_step_sentences(doc),
        *(f"{recording['name']}: {note}." for recording in doc["recordings"] for note in recording["notes"]),
        *doc["warnings"],
    ]


def collinear_sentences(doc: Document) -> list[str]:
    """List sentences about parameters that the recordings hardly distinguish."""
    sentences = []
    for group in doc["indistinct"]:
        names, directions, shrink = group["parameters"], group["direction"], group["shrink"] or 0.0
        if len(names) == 1:
            sentences.append(f"{names[0]} has no effect on the observed channels.")
            continue
        changes = _join_names(
            [f"{name} {'up' if d > 0 else 'down'}" for name, d in zip(names, directions, strict=True)]
        )
        effect = f"{100 * shrink:.2g} %" if shrink > _ALMOST_NOTHING else "almost nothing"
        sentences.append(
            f"Hard to distinguish: {changes}, changed together, have {effect} of the effect that each has alone."
        )
    return sentences


def table(rows: Sequence[Sequence[str]], right: Sequence[int] = ()) -> list[str]:
    """Format a table as lines with aligned columns.

    Args:
        rows: Cells, row by row, with the head first.
        right: Indices of the columns that are aligned to the right.
    """
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]

    def cell(text: str, k: int) -> str:
        return text.rjust(widths[k]) if k in right else text.ljust(widths[k])

    return ["   ".join(cell(text, k) for k, text in enumerate(row)) for row in rows]


def _three_digits(value: float) -> str:
    """Three significant digits, with trailing zeros."""
    return f"{value:#.3g}".removesuffix(".")


def _round_to(value: float | None, half: float) -> str:
    """A number to two digits of the half width of its interval; to four digits without an interval."""
    if value is None:
        return "-"
    if half <= 0:
        return f"{value:.4g}"
    place = math.floor(math.log10(half)) - 1
    size = math.floor(math.log10(abs(value))) if value else place
    if size >= _LARGE_EXPONENT or (size < _SMALL_EXPONENT and place < _SMALL_EXPONENT):
        return f"{value:.{max(size - place, 0)}e}"
    return f"{round(value, -place):.{max(-place, 0)}f}"


def _noise_sentences(doc: Document) -> list[str]:
    """Sentences about the noise of electrical inputs, and about intervals where more than noise remains."""
    sentences = [n["text"] for n in doc.get("input_noise", ()) if n["kind"] != "none"]  # absent in earlier documents
    above = [v.channel for v in residual_verdicts(doc) if v.ratio > _AT_NOISE]
    if above and not doc.get("failure"):
        sentences.append(
            f"The residual of {_join_names(above)} is above its noise: neighbouring samples err together, which the "
            "covariance behind the intervals contains (autocorrelation-robust, or sandwich)."
        )
    return sentences


def _undetermined_sentences(doc: Document) -> list[str]:
    if doc["solver"]["code"] == "failed" or doc.get("failure"):
        return []
    names = [name for name, entry in doc["parameters"].items() if is_undetermined(entry)]
    return [_undetermined_sentence(name, doc["parameters"][name], doc.get("profiles", {}).get(name)) for name in names]


def _undetermined_sentence(name: str, entry: Document, profile: Document | None) -> str:
    """Say that a parameter is not determined; only a profile has searched whether other values fit as well."""
    if profile is not None and all(rise is not None and rise < RISE_95 for rise in profile["rise"]):
        return (
            f"{name} is not determined: as its profile shows, these recordings fit about as well with any value of it "
            "within its bounds."
        )
    reason = (
        "small changes of it do not change the model"
        if entry["lower95"] is None
        else "its interval is wider than its bounds"
    )
    searched = "" if profile is not None else f"; --profile {name} shows whether other values fit as well"
    return f"{name} is not determined at this estimate: {reason}{searched}."


def _bound_sentences(doc: Document) -> list[str]:
    sentences = []
    for name, entry in doc["parameters"].items():
        if entry["at_bound"]:
            shown = entry.get("file_unit")
            estimate, _, _, unit = readable(entry["estimate"], None, None, unit=entry["unit"], shown=shown)
            sentences.append(
                f"{name} is at its bound, {estimate} {unit}".rstrip()
                + ", and has no interval: widen the bound under [fit] bounds if the parameter can go beyond it; "
                "if not, the model may be wrong."
            )
    return sentences


def _start_sentences(doc: Document) -> list[str]:
    solver = doc["solver"]
    starts, best = solver["starts"], solver["starts_at_best"]
    if solver["code"] == "steps":
        return [f"The search took all of its {solver['steps']} steps: --max-steps {4 * solver['steps']} allows more."]
    if solver["code"] == "failed" or solver["code"] in NOT_CONVERGED:
        return []
    if starts == 1:
        return ["Only one start was used: --starts 4 would show whether there are other minima."]
    if best == 1:
        return [
            f"Only 1 of {starts} starts reached the best minimum: more starts (--starts {4 * starts}) may find a "
            "better one."
        ]
    return [f"{best} of {starts} starts reached the best minimum."]


def _step_sentences(doc: Document) -> list[str]:
    """Sentences about channels whose time steps are too coarse."""
    sentences = []
    for channel, error in doc["discretisation"].items():
        floor = doc["noise_floor"][channel]["value"]
        if error["value"] is not None and floor and error["value"] > _COARSE_STEPS * floor:
            sentences.append(
                f"The time steps are coarse for {channel}: halving them changes the model by {error['value']:.2g} "
                f"{error['unit']}, {100 * error['value'] / floor:.0f} % of the noise floor; "
                "sample the recording more densely."
            )
    return sentences


def _join_names(names: Sequence[str]) -> str:
    names = list(names)
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
