"""The base class of all result documents, and of their parts."""

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field

Content = TypeVar("Content", bound=Mapping[str, Any])

# A number, or ``None`` (``null`` in JSON) where there is none or where it is NaN or infinite.
Number = float | None
# The lower and the upper end of an interval or of bounds.
Ends = Annotated[list[Number], Field(min_length=2, max_length=2)]
# The first and the last row, counted from 1.
Rows = Annotated[list[int], Field(min_length=2, max_length=2)]


class Part(BaseModel):
    """A part of a document.

    What smajax writes has exactly these keys (``check``), and values of exactly these types. A document that is read
    may have more keys, since a later version of smajax may add some to the same schema; they are kept.
    """

    model_config: ClassVar[ConfigDict] = ConfigDict(
        extra="allow",
        strict=True,
        allow_inf_nan=False,
        frozen=True,
        serialize_by_alias=True,
        defer_build=True,  # a command uses one of the documents
    )

    @classmethod
    def check(cls, content: Content) -> Content:
        """Return content that smajax is about to write, unchanged.

        Args:
            content: The content, as builders of documents compute it.

        Raises:
            pydantic.ValidationError: If it does not fit the model, which is a fault in smajax.
        """
        cls.model_validate(content, extra="forbid")
        return content

    def to_dict(self) -> dict[str, Any]:
        """Return the content as it stands in the file: the same keys, also those of a newer version, and values."""
        return self.model_dump(exclude_unset=True)


class Document(Part):
    """A result document.

    Attributes:
        schema_name: Name and version of the schema.
    """

    # Name and version of the schema, and those of earlier versions that are readable.
    SCHEMA: ClassVar[str]
    EARLIER: ClassVar[tuple[str, ...]] = ()

    schema_name: str = Field(alias="schema", description="name and version of the schema")

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> Self:
        """Return the document with this content; keys that the model does not have are kept.

        Args:
            content: The content of a file of the current schema.

        Raises:
            pydantic.ValidationError: If a key is missing, or a value has another type.
        """
        return cls.model_validate(content)
