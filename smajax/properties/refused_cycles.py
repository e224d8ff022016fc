"""Cycles that cannot be analysed, and their sentences: one for all cycles of a recording with the same reason."""

import dataclasses
from collections.abc import Sequence
from typing import Any

from smajax.errors import InputError

# Number of ranges of cycle numbers that are listed: as many as fit on a line with the sentence.
_MAX_LISTED = 6


@dataclasses.dataclass(frozen=True)
class RefusedCycle:
    """The reason why a cycle, or all cycles of a recording, cannot be analysed.

    Attributes:
        recording: Name of the recording.
        error: The reason, with its code and fields; its text names the cure.
        number: Number of the cycle in its recording, from 1; ``None`` where the reason holds for the recording, whose
            name is then in the text.
        rows: First and last row of the cycle, from 0; ``None`` for a recording.
    """

    recording: str
    error: InputError
    number: int | None = None
    rows: tuple[int, int] | None = None

    def __str__(self) -> str:
        """The reason as a sentence."""
        if self.number is None or self.rows is None:
            return str(self.error)
        return f"{self.recording}, cycle {self.number} ({self._rows_text()}): {self.error}"

    def _rows_text(self) -> str:
        first, last = self.rows or (0, 0)
        return f"rows {first + 1} to {last + 1}"

    def _key(self) -> tuple[Any, ...]:
        """What cycles have in common that share a sentence."""
        if self.number is None:
            return self.recording, str(self.error)
        return self.recording, self.error.code or str(self.error), *sorted(self.error.fields.items())


def merge_refusals(refused: Sequence[RefusedCycle]) -> list[str]:
    """Return the sentences about cycles, one for all cycles of a recording whose reasons have the same code and fields.

    Args:
        refused: The reasons.
    """
    groups: dict[tuple[Any, ...], list[RefusedCycle]] = {}
    for refusal in refused:
        groups.setdefault(refusal._key(), []).append(refusal)
    return [
        _merged(group) if len(group) > 1 and group[0].number is not None else str(group[0]) for group in groups.values()
    ]


def _merged(group: Sequence[RefusedCycle]) -> str:
    """The sentence of several cycles of one recording."""
    first, numbers = group[0], _list_numbers([refusal.number or 0 for refusal in group])
    return (
        f"{first.recording}, {len(group)} cycles ({numbers}), the first of them ({first._rows_text()}): {first.error}"
    )


def _list_numbers(numbers: Sequence[int]) -> str:
    """List ascending numbers, successive ones as "3 to 7"."""
    ends = [k for k in range(len(numbers)) if k + 1 == len(numbers) or numbers[k + 1] > numbers[k] + 1]
    begins = [0, *(k + 1 for k in ends[:-1])]
    parts = [f"{numbers[a]}" if a == b else f"{numbers[a]} to {numbers[b]}" for a, b in zip(begins, ends, strict=True)]
    omitted = len(numbers) - begins[_MAX_LISTED] if len(parts) > _MAX_LISTED else 0
    return ", ".join(parts[:_MAX_LISTED]) + (f" and {omitted} more" if omitted else "")
