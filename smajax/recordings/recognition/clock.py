"""Time: the column of the clock and its unit, or the sample period that is missing."""

import dataclasses
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from smajax.recordings.column_mapping import ChannelMap
from smajax.recordings.recognition.answers import LEFT_OUT
from smajax.recordings.recognition.column_choice import ColumnChoice
from smajax.recordings.recognition.findings import Question
from smajax.recordings.recognition.unit_names import unit_for
from smajax.recordings.recognition.value_ranges import Floats, Scale, are_whole

# Least share of the steps that are positive in a column of times, since loggers repeat stamps, and largest ratio of
# negative steps to positive ones, since clocks begin again. Chosen by the public recordings.
_RISING_SHARE = 0.1
_FALLING_RATIO = 0.5
# Longest step (s) that may be a sample period.
_LONGEST_STEP = 10.0
# Share of the steps that are equal in a column that counts a sample period.
_EQUAL_SHARE = 0.8
_STEP_TOLERANCE = 1e-6
# Seconds, milliseconds and microseconds since 1970 in this century.
_EPOCHS = ((1e9, 1e10, "s"), (1e12, 1e13, "ms"), (1e15, 1e16, "us"))
# Least duration (s) that is plausible for a recording in ms, and longest one in s with steps of more than 1 s.
_SHORTEST, _LONGEST = 1.0, 6 * 3600.0
# Whole steps from here on are usual for loggers in ms (100 Hz), and less so for rows in s.
_MS_STEP = 10
# Whole steps from here on are usual in us (200 Hz) rather than in ms.
_US_STEP = 5000


def choose_clock(
    choices: Sequence[ColumnChoice], values: Mapping[int, Floats], stamps: Collection[int], has_period: bool
) -> list[ColumnChoice]:
    """Return the choices with at most one column of times, which has a unit.

    Args:
        choices: What each column is taken for.
        values: Values, shape ``(rows,)``, by the number of the column; seconds where they are time stamps.
        stamps: Numbers of the columns of time stamps.
        has_period: Whether a sample period was given in place of a time column.
    """
    result = {choice.index: choice for choice in choices}
    for k in stamps:
        if not result[k].is_answer:
            source = ChannelMap(result[k].header, "s")
            result[k] = ColumnChoice(k, result[k].header, "time", source, "its cells are time stamps")
    candidates = [choice for choice in result.values() if choice.channel == "time"]
    if has_period:
        reason = "a sample period was given instead"
        return list((result | {c.index: _dropped(c, reason) for c in candidates}).values())
    for choice in [c for c in candidates if not c.is_answer and not _rises(values[c.index])]:
        result[choice.index] = _dropped(choice, "it does not rise from row to row as time does")
        candidates.remove(choice)
    if not candidates:
        return list(result.values())
    best = max(candidates, key=lambda c: (c.is_answer, c.index in stamps, _has_unit(c), _step_count(values[c.index])))
    reason = f"column '{best.header}' is the time"
    result |= {c.index: _dropped(c, reason) for c in candidates if c is not best}
    result[best.index] = _with_unit(best, values[best.index], best.index in stamps)
    return list(result.values())


def period_question(choices: Sequence[ColumnChoice], values: Mapping[int, Floats]) -> Question:
    """Return the question for the sample period of a file without a time column.

    Args:
        choices: What each column is taken for.
        values: Values, shape ``(rows,)``, by the number of the column.
    """
    text = "no column is a time, so that the rows have an order and no clock"
    for choice in choices:
        step = _usual_step(values[choice.index])
        if choice.channel is None and step is not None and step != 1:
            hint = (
                f"column '{choice.header}' changes by {step:.6g} from row to row, which may be the sample period in s"
            )
            example = f"{step * 1000:.6g} ms"
            return Question("sample_period", f"{text}; {hint}", "", (example,), False, f"--sample-period '{example}'")
    return Question("sample_period", text, "", ("20 ms",), False, "--sample-period '20 ms'")


def time_scale(word: str, values: Floats) -> Scale:
    """Return the unit of times whose header has none.

    Args:
        word: Name of the column.
        values: Finite values.
    """
    named = unit_for(word, "time") if len(word) > 1 else None
    if named:
        return Scale(named, f"its name counts {named}")
    for low, high, unit in _EPOCHS:
        if low <= values.min() and values.max() < high:
            return Scale(unit, f"{values[0]:.10g} is the number of {unit} since 1970")
    steps = np.diff(values)
    step, duration = float(np.median(steps[steps > 0])), float(np.ptp(values))
    if not are_whole(values) or step <= 1:
        return Scale("s", f"no unit, and steps of {step:.4g} over {duration:.5g} are usual in s")
    in_ms, in_s = duration / 1000 >= _SHORTEST, duration <= _LONGEST
    if not in_s:
        unit = "us" if step >= _US_STEP else "ms"
        return Scale(unit, f"no unit, and whole steps of {step:.4g} over {duration:.5g} are usual in {unit}")
    if not in_ms:
        return Scale("s", f"no unit, and {duration:.5g} ms would be a very short recording")
    unit, other = ("ms", "s") if step >= _MS_STEP else ("s", "ms")
    doubt = f"the header has no unit, and whole steps of {step:.4g} over {duration:.5g} may be in ms or in s"
    return Scale(unit, "no unit", doubt, (f"[{other}]",))


def _with_unit(choice: ColumnChoice, values: Floats, is_stamp: bool) -> ColumnChoice:
    """Return the choice of the time with its unit, by the header or by the steps."""
    source = choice.source or ChannelMap(choice.header)
    if is_stamp:
        return dataclasses.replace(choice, source=dataclasses.replace(source, unit="s"))
    if source.unit:
        reason = choice.reason if choice.is_answer else f"{choice.reason}; the unit is {source.unit}"
        return dataclasses.replace(choice, reason=reason)
    scale = time_scale(choice.word or choice.header, values[np.isfinite(values)])
    source = dataclasses.replace(source, unit=scale.unit)
    question = None
    if scale.doubt:
        others = tuple(f"time {other}" for other in (*scale.others, LEFT_OUT) if other != LEFT_OUT)
        option = f"--channel '{choice.header} = {others[0]}'"
        question = Question(choice.header, scale.doubt, f"time [{scale.unit}]", others, True, option)
    return dataclasses.replace(choice, source=source, reason=f"{choice.reason}; {scale.reason}", question=question)


def _has_unit(choice: ColumnChoice) -> bool:
    return choice.source is not None and choice.source.unit is not None


def _step_count(values: Floats) -> int:
    """Return the number of steps that are positive."""
    return int(np.count_nonzero(np.diff(values[np.isfinite(values)]) > 0))


def _rises(values: Floats) -> bool:
    steps = np.diff(values[np.isfinite(values)])
    rises, falls = np.count_nonzero(steps > 0), np.count_nonzero(steps < 0)
    return bool(rises > _RISING_SHARE * len(steps) and falls < _FALLING_RATIO * rises)


def _usual_step(values: Floats) -> float | None:
    """Return the step by which values rise or fall in most rows; ``None`` without one."""
    numbers = values[np.isfinite(values)]
    steps = abs(np.diff(numbers))
    if not len(steps):
        return None
    step = float(np.median(steps))
    equal = np.count_nonzero(abs(steps - step) <= _STEP_TOLERANCE * max(1.0, abs(step)))
    return step if 0 < step <= _LONGEST_STEP and equal >= _EQUAL_SHARE * len(steps) else None


def _dropped(choice: ColumnChoice, reason: str) -> ColumnChoice:
    return ColumnChoice(choice.index, choice.header, None, None, reason)
