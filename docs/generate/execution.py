"""Execution of what pages show: the steps of a page in their order, several pages at a time.

A page shows outputs of commands (``<!-- output of: ... -->``), commands that refuse their input with the sentence that
they print (``<!-- refusal of: ... -->``), figures (``<!-- figure of: ... -->``) and, if it is a notebook, outputs of
cells (``<!-- cell N of: ... -->``).
"""

from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor

from docs.generate.blocks import OUTPUT, REFUSAL, blocks
from docs.generate.figures import FIGURE, figure_of
from docs.generate.outputs import output_of, prepare_folders, refusal_of, run_python, write_file
from docs.generate.tutorial import CELL, TUTORIALS, cell_output

# Most commands use one core and a half; two at a time keep the two cores of a small machine busy.
PAGES_AT_A_TIME = 2
_SHOWN = (OUTPUT, REFUSAL, FIGURE, CELL)
_pages: dict[str, Future[dict[str, str]]] = {}


def begin(texts: Mapping[str, str]) -> None:
    """Begin to execute pages, those with the most steps first.

    Args:
        texts: Text of each page.
    """
    stop()
    prepare_folders()
    steps = {page: sum(len(pattern.findall(text)) for pattern in _SHOWN) for page, text in texts.items()}
    pool = ThreadPoolExecutor(PAGES_AT_A_TIME)
    for page in sorted((page for page, number in steps.items() if number), key=lambda page: -steps[page]):
        _pages[page] = pool.submit(outputs, texts[page], page)
    pool.shutdown(wait=False)


def stop() -> None:
    """Drop the pages that have not been begun."""
    for future in _pages.values():
        future.cancel()
    _pages.clear()


def with_outputs(markdown: str, page: str) -> str:
    """Return the text of a page with its outputs, for which it waits.

    Args:
        markdown: The text.
        page: The page.

    Raises:
        CommandError: If a step of the page failed.
    """
    if page not in _pages:
        return markdown
    shown = _pages[page].result()
    for pattern in _SHOWN:
        markdown = pattern.sub(lambda match: shown[match[0]], markdown)
    return markdown


def outputs(markdown: str, page: str) -> dict[str, str]:
    """Execute a page; return its outputs by the lines in place of which they stand.

    Args:
        markdown: The text of the page.
        page: The page, which determines the folder of its commands.

    Raises:
        CommandError: If a step fails.
    """
    for block in blocks(markdown):
        if block.is_first:
            run_python(block.text, page)
        elif block.file:
            write_file(block.file, block.text, page)
    shown = {match[0]: output_of(match[1], page) for match in OUTPUT.finditer(markdown)}
    shown |= {match[0]: refusal_of(match[1], page) for match in REFUSAL.finditer(markdown)}
    shown |= {match[0]: figure_of(match[1], match[2], page) for match in FIGURE.finditer(markdown)}
    return shown | {match[0]: cell_output(int(match[1]), TUTORIALS / match[2]) for match in CELL.finditer(markdown)}
