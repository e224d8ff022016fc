"""Names of the generated parts, the pages that are generated as a whole, and files that pages link to."""

from collections.abc import Callable
from pathlib import Path

from docs.generate import (
    api,
    bibliography,
    commands,
    documents,
    effect_equations,
    effects,
    experiment_list,
    keys,
    sets,
    topics,
    tutorial,
)

ROOT = Path(__file__).resolve().parents[2]
# Parts by the name in a line <!-- generated: NAME --> of a page.
PARTS: dict[str, Callable[[], str]] = {
    "bibliography": bibliography.bibliography,
    "command-list": commands.command_list,
    "commands": commands.commands,
    "controller-keys": keys.controller_keys,
    "documents": documents.documents,
    "effect-equations": effect_equations.effect_equations,
    "effects": effects.effects,
    "experiments": experiment_list.experiments,
    "messages": topics.messages,
    "parameter-sets": sets.parameter_sets,
    "public-names": api.public_names,
    "reading-options": commands.reading_options,
    "rig-keys": keys.rig_keys,
    "device-keys": keys.device_keys,
    "set-keys": keys.set_keys,
    "sweep-keys": keys.sweep_keys,
}
# Pages of the site by the file of the repository that they show.
PAGES_OF_FILES = {
    "docs/references.bib": "reference/bibliography.md",
    "docs/tutorials/close_the_loop.py": "tutorials/close_the_loop.md",
    "smajax/plant/effects/README.md": "how-to/write-an-effect.md",
}
# Files outside of docs that pages link to, which the site has as they are.
LINKED_FILES = ("data/plausible-ranges.toml", "docs/tutorials/close_the_loop.py", "docs/references.bib")


def whole_pages() -> dict[str, str]:
    """Return the pages that are generated as a whole, by path."""
    effect = (ROOT / "smajax" / "plant" / "effects" / "README.md").read_text("utf-8")
    return {"how-to/write-an-effect.md": effect, **tutorial.tutorial_pages(), **api.api_pages()}
