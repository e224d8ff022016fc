"""Registries: the classes of materials, mechanisms and effects by the names under which rig files select them.

A registry is a mapping from names to classes. It has the shipped classes, those that ``register`` adds, and those of
installed packages, which name them as entry points of the group of the registry:

    [project.entry-points."smajax.materials"]
    my-law = "my_package:MyLaw"

Entry points are looked at only where a name is not known otherwise, or where all names are asked for.
"""

import dataclasses
import importlib.metadata
import re
import warnings
from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from typing import Any, TypeVar

import equinox as eqx

from smajax.errors import InputError, missing_attributes, missing_methods, shortened, suggestion
from smajax.parameters import module_types

Module = TypeVar("Module", bound=eqx.Module)
_NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")
_DECLARED_FIELD = "{name}: jax.Array = smajax.parameter(UNIT, MEANING, LOWER, UPPER, DEFAULT)"


class Registry(Mapping[str, type[Module]]):
    """Classes of one kind by name.

    Attributes:
        kind: What the classes are, in one word: ``material``.
        base: Base class of all classes.
        group: Group of the entry points of installed packages: ``smajax.materials``.

    Args:
        kind: What the classes are.
        base: Base class of all classes.
        shipped: Function that returns the shipped classes by name; it is called once, when they are needed.
        check: Function that returns all that is wrong with a class of this kind under a name, in words with the
            cures; an empty text if nothing is. The class may lack attributes that its base class demands.
    """

    def __init__(
        self,
        kind: str,
        base: type[Module],
        shipped: Callable[[], Mapping[str, type[Module]]],
        check: Callable[[str, type[Module]], str] = lambda name, cls: "",
    ):
        self.kind: str = kind
        self.base = base
        self.group: str = f"smajax.{kind}s"
        self._read_shipped, self._check = shipped, check
        self._added: dict[str, type[Module]] = {}
        self._broken: dict[str, str] = {}

    @cached_property
    def _shipped(self) -> Mapping[str, type[Module]]:
        return dict(self._read_shipped())

    @cached_property
    def _entry_points(self) -> dict[str, list[Any]]:
        """The entry points by name: several where packages offer different classes under one name."""
        # Not always of importlib.metadata.EntryPoint: the package importlib_metadata adds its own class when imported.
        points: dict[str, list[Any]] = {}
        for point in importlib.metadata.entry_points(group=self.group):
            others = points.setdefault(point.name, [])
            if point.value not in [other.value for other in others]:
                others.append(point)
        return points

    @property
    def loaded(self) -> Mapping[str, type[Module]]:
        """The classes by name without those of installed packages that no one has asked for yet."""
        return {**self._shipped, **self._added}

    @property
    def is_extended(self) -> bool:
        """Whether classes were added to the shipped ones."""
        return bool(self._added)

    @property
    def names(self) -> tuple[str, ...]:
        """All names, those included that installed packages offer; none is imported for this."""
        return tuple(dict.fromkeys([*self.loaded, *self._entry_points]))

    def __repr__(self) -> str:
        """Return the kind and the names in words."""
        return f"<{self.kind}s: {', '.join(self.names)}>"

    def register(self, name: str, cls: Any) -> None:
        """Add a class under a name.

        A class may be registered again under its name after its definition was run again, as in a notebook.

        Args:
            name: The name, in small letters with hyphens: ``my-law``.
            cls: The class.

        Raises:
            InputError: If the name is taken or has another form, or the class cannot be used.
        """
        if problem := self._problem(name, cls):
            raise InputError(f"{self.kind} '{name}': {problem}")
        self._added[name] = cls

    def unregister(self, name: str) -> None:
        """Remove a class that was registered.

        Args:
            name: Its name.

        Raises:
            InputError: If no class was registered under this name.
        """
        if name not in self._added:
            hint = suggestion(name, self._added)
            raise InputError(f"{self.kind} '{name}' was not registered{hint}: there is nothing to remove")
        del self._added[name]

    def __getitem__(self, name: str) -> type[Module]:
        """Return the class of a name; one of an installed package is imported first.

        Raises:
            KeyError: If there is no such name.
            InputError: If an installed package names a class that cannot be imported or used, or two offer the name.
        """
        if name in self._shipped:
            return self._shipped[name]
        if name not in self._added and name in self._entry_points:
            self._load(name)
        return self._added[name]

    def __contains__(self, name: object) -> bool:
        """Return whether a name is known."""
        return name in self._shipped or name in self._added or name in self._entry_points

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names; what an installed package names and cannot be used is left out with a warning."""
        for name in self._entry_points:
            if name in self._added or name in self._broken:
                continue
            try:
                self._load(name)
            except InputError as error:
                self._broken[name] = str(error)
                warnings.warn(str(error), stacklevel=2)
        return iter(self.loaded)

    def __len__(self) -> int:
        """Return the number of names."""
        return len(list(iter(self)))

    def _load(self, name: str) -> None:
        """Import the class that an installed package names, and add it."""
        points = self._entry_points[name]
        packages = [point.dist.name if point.dist else point.module for point in points]
        if len(points) > 1:
            offers = " and ".join(f"{package} ({p.value})" for package, p in zip(packages, points, strict=True))
            raise InputError(f"the packages {offers} offer the {self.kind} '{name}': uninstall all but one of them")
        (point,), (package,) = points, packages
        try:
            self.register(name, point.load())
        except Exception as error:
            problem = str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"
            raise InputError(
                f"the package {package} offers the {self.kind} '{name}' ({point.value}), which cannot be used: "
                f"{problem}; repair or uninstall {package}"
            ) from error

    def _problem(self, name: str, cls: Any) -> str:
        """Return what is wrong with a name, or all that is wrong with a class; an empty text if nothing is."""
        if not isinstance(name, str) or not _NAME.fullmatch(name):
            return "the name is not in small letters with hyphens: write it like 'my-law'"
        if not isinstance(cls, type):
            shown = shortened(" ".join(repr(cls).split()))
            return f"{shown} is not a class: give the class itself, without parentheses behind its name"
        if not issubclass(cls, self.base):
            return f"{cls.__name__} is not of this kind: derive it from {self.base.__module__}.{self.base.__name__}"
        other = self.loaded.get(name)
        if other is not None and (other.__module__, other.__qualname__) != (cls.__module__, cls.__qualname__):
            return f"the name is taken by {other.__module__}.{other.__qualname__}: choose another name"
        problems = [problem for problem in (self._class_problem(cls), self._check(name, cls)) if problem]
        return f"{cls.__name__} cannot be used: {'; '.join(problems)}" if problems else ""

    def _class_problem(self, cls: Any) -> str:
        """Return all that a class lacks, with the cures; an empty text if it is complete."""
        return class_problem(cls)


def class_problem(cls: type[Any]) -> str:
    """Return all that a class lacks, with the cures: methods, class attributes, and declarations of fields.

    Args:
        cls: A class derived from ``CheckedModule``.

    Returns:
        The problems in words; an empty text if there is none.
    """
    problems = [missing] if (missing := missing_methods(cls)) else []
    if constants := missing_attributes(cls):
        problems.append(f"define {', '.join(map(repr, constants))} in the body of the class")
    for name in sorted(getattr(cls, "__abstractvars__", ())):
        problems.append(f"define '{name}' in the body of the class: {_DECLARED_FIELD.format(name=name)}")
    for field in dataclasses.fields(cls):
        if "declaration" not in field.metadata and not field.metadata.get("static") and not module_types(cls, field):
            cure = f"write {_DECLARED_FIELD.format(name=field.name)}, or equinox.field(static=True) for an option"
            problems.append(f"its field '{field.name}' has no declaration: {cure}")
    return "; ".join(problems)
