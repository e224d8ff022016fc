"""The texts of ``smajax explain`` on words of messages."""

import posixpath

from smajax.app.commands.explain import topics


def messages() -> str:
    """Return a section for each topic, with the page that has more."""
    return "\n".join(
        f"\n## {topic.title} {{ #{topic.name} }}\n\n`smajax explain {topic.name}`\n\n{topic.text}\n\n"
        f"More: [{topic.page}]({posixpath.relpath(topic.page, 'reference')})\n"
        for topic in topics().values()
    )
