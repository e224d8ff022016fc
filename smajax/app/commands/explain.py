"""Job of ``smajax explain``: short texts on words of messages and on effects, without a network.

The texts of words are ``data/topics/NAME.md``, those of effects come from their classes. The documentation site shows
the same texts.
"""

import re
from difflib import get_close_matches
from textwrap import wrap

from smajax.app.commands.catalogues import effect_lines
from smajax.errors import InputError
from smajax.plant.effects import catalogue
from smajax.report.topics import TEXT_WIDTH, plain_text, read_topics

# Most names that a message suggests, and the similarity (difflib's ratio) from which it does; chosen by trial,
# tests/integration/test_explain.py holds them.
_NEAR = 3
_SIMILARITY = 0.6


def explain_text(name: str | None = None) -> str:
    """Return the text on a topic for a terminal, or the list of all topics.

    Args:
        name: Name of the topic or key of an effect; ``None`` for the list.

    Raises:
        InputError: If there is no such topic.
    """
    words, effects = read_topics(), catalogue()
    if name is None:
        width = max(map(len, words))
        lines = [f"{topic.name.ljust(width)}  {topic.title}" for topic in words.values()]
        keys = wrap(f"Effects: {', '.join(sorted(effects))}", TEXT_WIDTH, break_on_hyphens=False)
        return "\n".join([*lines, "", *keys, "", "smajax explain TOPIC describes one of them."])
    key = re.sub(r"[\s_]+", "-", name.strip().lower())
    others = {word: topic for topic in words.values() for word in topic.words}
    topic = words.get(key) or others.get(key)
    if topic:
        return f"{topic.title}\n\n{plain_text(topic.text)}\n\nMore: docs/{topic.page}"
    if key in effects:
        return "\n".join([*effect_lines(key, effects[key]), "", "More: docs/reference/effects.md"])
    names = [*words, *others, *effects]
    near = list(dict.fromkeys([*(n for n in names if key in n), *get_close_matches(key, names, _NEAR, _SIMILARITY)]))
    hint = f" (near it: {', '.join(near[:_NEAR])})" if key and near else ""
    raise InputError(f"there is no topic '{name}'{hint}: 'smajax explain' lists those that there are")
