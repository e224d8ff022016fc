"""Limits of a material, and the diameters in which its wire is sold, from the parameter set of the material.

    [[limits.stress]]
    value = "172 MPa"
    cycles = 1_000_000
    source = "dynalloy: ..."

    [limits.temperature]
    value = "120 degC"
    source = "..."

    [limits.strain]
    value = "3.5 %"
    source = "..."

    [catalogue]
    wire = "Flexinol"
    diameters = ["0.1 mm", "0.15 mm"]
    source = "..."

The stress is that which a wire bears for a number of cycles; there may be several. The strain is the range that a wire
passes through in a cycle. Every value has a source.
"""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel, Field

from smajax.errors import InputError
from smajax.files.parameter_sets import read_header
from smajax.files.toml import STRICT, quantity_at, validate

# Units of the limits by name; each is an upper limit.
LIMIT_UNITS = {"stress": "Pa", "temperature": "degC", "strain": "1"}


class LimitTable(BaseModel):
    """``[limits.NAME]``."""

    model_config = STRICT
    value: Any = Field(description="largest value that is safe", examples=['"120 degC"'])
    source: str = Field(min_length=1, description="where the value comes from", examples=['"data sheet"'])
    cycles: float | None = Field(
        None, gt=0.0, description="cycles that a wire bears at a stress; for stresses alone", examples=["1_000_000"]
    )


class LimitSections(BaseModel):
    """``[limits]``."""

    model_config = STRICT
    stress: list[Any] = Field(
        [],
        description="stresses, each for a number of cycles; also written [[limits.stress]]",
        examples=['[{ value = "172 MPa", cycles = 1_000_000, source = "data sheet" }]'],
    )
    temperature: dict[str, Any] | None = Field(
        None, description="temperature of the wire", examples=['{ value = "120 degC", source = "data sheet" }']
    )
    strain: dict[str, Any] | None = Field(
        None,
        description="range of the strain in a cycle",
        examples=['{ value = "3.5 %", source = "data sheet" }'],
    )


class CatalogueTable(BaseModel):
    """``[catalogue]``."""

    model_config = STRICT
    wire: str = Field(min_length=1, description="name of the wire", examples=['"Flexinol"'])
    diameters: list[Any] = Field(
        min_length=1, description="diameters in which it is sold", examples=['["0.1 mm", "0.15 mm"]']
    )
    source: str = Field(min_length=1, description="where they come from", examples=['"data sheet"'])


@dataclass(frozen=True)
class Limit:
    """Largest value of a quantity of a wire that is safe.

    Attributes:
        value: The value in the unit of ``LIMIT_UNITS``.
        source: Where it comes from.
        cycles: Number of cycles that a wire bears at this stress; ``None`` for other quantities.
    """

    value: float
    source: str
    cycles: float | None = None


@dataclass(frozen=True)
class MaterialLimits:
    """Limits of a material.

    Attributes:
        name: Name of the parameter set.
        stress: Limits of the stress, that of the fewest cycles first.
        temperature: Limit of the temperature; ``None`` if the set has none.
        strain: Limit of the strain range of a cycle; ``None`` if the set has none.
    """

    name: str
    stress: tuple[Limit, ...] = ()
    temperature: Limit | None = None
    strain: Limit | None = None

    def for_life(self, cycles: float) -> dict[str, Limit]:
        """Return the limits of a wire that is to last a number of cycles, by name (``LIMIT_UNITS``).

        The stress is that of the fewest cycles that suffice; stresses between two are not interpolated.

        Args:
            cycles: Number of cycles.

        Raises:
            InputError: If no stress of the set is for so many cycles.
        """
        chosen = {n: limit for n in ("temperature", "strain") if (limit := getattr(self, n)) is not None}
        if not self.stress:
            return chosen
        enough = [limit for limit in self.stress if (limit.cycles or 0.0) >= cycles]
        if not enough:
            raise InputError(
                f"parameter set {self.name} has no stress for {cycles:,.0f} cycles, its largest number is "
                f"{self.stress[-1].cycles:,.0f}: ask for fewer cycles, or add a stress with its source to a set"
            )
        return {"stress": enough[0], **chosen}

    def to_document(self) -> dict[str, Any]:
        """Return the limits as a JSON document; see ``limits_from_document``."""
        document = asdict(self)
        return document | {"stress": [dict(entry) for entry in document["stress"]]}


@dataclass(frozen=True)
class Catalogue:
    """Diameters in which a wire is sold.

    Attributes:
        name: Name of the parameter set.
        wire: Name of the wire.
        diameters: Diameters in m, in ascending order.
        source: Where they come from.
    """

    name: str
    wire: str
    diameters: tuple[float, ...]
    source: str


def limits_from_document(document: Mapping[str, Any]) -> MaterialLimits:
    """Return the limits of a document of ``MaterialLimits.to_document``."""
    single = {n: Limit(**document[n]) for n in ("temperature", "strain") if document[n] is not None}
    return MaterialLimits(document["name"], tuple(Limit(**entry) for entry in document["stress"]), **single)


def read_limits(path: Path, name: str) -> MaterialLimits | None:
    """Read the limits of a parameter set.

    Args:
        path: The file.
        name: Name of the set in messages.

    Returns:
        The limits; ``None`` if the set has none.

    Raises:
        InputError: If the file is missing, or a limit is not valid; the message names file and key.
    """
    return _read_table(path, "limits", lambda content: _limits_of(name, validate(LimitSections, content, "limits")))


def _limits_of(name: str, sections: LimitSections) -> MaterialLimits:
    stress = [_read_limit("stress", f"limits.stress {k}", table) for k, table in enumerate(sections.stress, 1)]
    single = {
        key: _read_limit(key, f"limits.{key}", getattr(sections, key))
        for key in ("temperature", "strain")
        if getattr(sections, key) is not None
    }
    return MaterialLimits(name, tuple(sorted(stress, key=lambda limit: limit.cycles or 0.0)), **single)


def _read_limit(key: str, place: str, table: Any) -> Limit:
    fields = validate(LimitTable, table, place)
    if fields.cycles is None and key == "stress":
        raise InputError(f"{place}.cycles is missing: add the number of cycles that a wire bears at this stress")
    if fields.cycles is not None and key != "stress":
        raise InputError(f"{place}.cycles has no place here, only a stress is that of a number of cycles: take it out")
    return Limit(quantity_at(fields.value, LIMIT_UNITS[key], f"{place}.value"), fields.source, fields.cycles)


def read_catalogue(path: Path, name: str) -> Catalogue | None:
    """Read the diameters in which the wire of a parameter set is sold.

    Args:
        path: The file.
        name: Name of the set in messages.

    Returns:
        The catalogue; ``None`` if the set has none.

    Raises:
        InputError: If the file is missing, or the catalogue is not valid; the message names file and key.
    """
    return _read_table(path, "catalogue", lambda content: _catalogue_of(name, content))


def _catalogue_of(name: str, content: Any) -> Catalogue:
    fields = validate(CatalogueTable, content, "catalogue")
    diameters = [quantity_at(text, "m", "catalogue.diameters") for text in fields.diameters]
    if wrong := [text for text, size in zip(fields.diameters, diameters, strict=True) if not size > 0.0]:
        raise InputError(f"catalogue.diameters has {wrong[0]}: give diameters above 0")
    return Catalogue(name, fields.wire, tuple(sorted(set(diameters))), fields.source)


def _read_table(path: Path, key: str, build: Callable[[Any], Any]) -> Any:
    """What a table of a parameter set describes, ``None`` without the table; messages name the file."""
    content = read_header(path).get(key)
    if content is None:
        return None
    try:
        return build(content)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
