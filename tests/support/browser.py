"""A browser for pages, found on the machine: no download, no network, software WebGL."""

import os
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Any

import numpy as np
import pytest

NAMES = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome", "chrome")
"""Programs that run a page, the smallest first."""
SOFTWARE = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox")
"""WebGL2 without a GPU."""
WAIT = 60.0
"""Seconds until a page that is not ready has failed: other work may share the machine."""
READY = "() => document.documentElement.dataset.ready === 'yes'"
DRAWN = "(n) => document.querySelectorAll('.viewer')[n].viewer?.levels !== undefined"


@contextmanager
def launching() -> Iterator[Callable[..., Any]]:
    """What starts a browser with given arguments. Skips the test on a machine without a browser,
    and fails it where CI is set."""
    program = next(filter(None, map(shutil.which, NAMES)), None)
    if program is None:
        if os.environ.get("CI"):
            pytest.fail(f"expected one of {', '.join(NAMES)}, got none")
        pytest.skip("no browser here")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play, ExitStack() as stack:

        def launch(*arguments: str) -> Any:
            browser = play.chromium.launch(
                executable_path=program, args=list(arguments or SOFTWARE)
            )
            stack.callback(browser.close)
            return browser

        yield launch


def wait_for(page: Any, condition: str, argument: Any = None, errors: Sequence[str] = ()) -> None:
    """Wait until a JavaScript function is true; ``errors`` fail at once. The browser's own polling
    needs eval, which the pages forbid."""
    end = time.monotonic() + WAIT
    while not page.evaluate(condition, argument):
        assert not errors, errors
        assert time.monotonic() < end, condition
        time.sleep(0.02)


@contextmanager
def opened(browser: Any, url: str, size: tuple[int, int] = (1000, 700)) -> Iterator[Any]:
    """A page, offline, that is ready. On leaving: no request but its own file, and no error."""
    width, height = size
    context = browser.new_context(viewport={"width": width, "height": height}, offline=True)
    page, requests, errors = context.new_page(), [], []
    page.on("request", lambda request: requests.append(request.url.split("#")[0]))
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("console", lambda said: errors.append(said.text) if said.type == "error" else None)
    try:
        page.goto(url)
        wait_for(page, READY, errors=errors)
        yield page
        own = url.split("#")[0]
        assert [r for r in requests if r not in (own, "about:srcdoc")] == []
        assert errors == []
    finally:
        context.close()


def levels(page: Any, viewer: int = 0) -> np.ndarray:
    """(h, w, 3) levels that a viewer of a page has drawn, once its changes are drawn."""
    page.evaluate("() => new Promise((f) => requestAnimationFrame(() => requestAnimationFrame(f)))")
    wait_for(page, DRAWN, viewer)
    values, (width, height) = page.evaluate(
        "(n) => { const v = document.querySelectorAll('.viewer')[n].viewer;"
        " return [Array.from(v.levels), v.engine().size]; }",
        viewer,
    )
    # The bottom row comes first.
    return np.array(values).reshape(height, width, 4)[::-1, :, :3]
