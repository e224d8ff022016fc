"""Pages as a browser draws them."""

import shutil
import subprocess
from pathlib import Path

import pytest

# Seconds for one page on a busy machine; where the browser does not end within them, it is started once more.
TIME_LIMIT = 90.0
WORDS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-extensions", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--no-first-run", "--virtual-time-budget=20000", "--dump-dom",
)  # fmt: skip


def drawn_page(page: Path, folder: Path) -> str:
    """The elements of a page after Chromium has drawn it, as HTML; skips the test where there is none.

    Args:
        page: The file of the page.
        folder: An empty folder for the files of the browser.

    Returns:
        The elements as HTML.

    Raises:
        subprocess.TimeoutExpired: If the browser did not end at the second try either.
    """
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if browser is None:
        pytest.skip("there is no Chromium on this machine")
    try:
        return _dumped(browser, page, folder / "first")
    except subprocess.TimeoutExpired:
        return _dumped(browser, page, folder / "second")


def _dumped(browser: str, page: Path, profile: Path) -> str:
    words = [browser, *WORDS, f"--user-data-dir={profile}", page.as_uri()]
    return subprocess.run(words, capture_output=True, text=True, timeout=TIME_LIMIT, encoding="utf-8").stdout
