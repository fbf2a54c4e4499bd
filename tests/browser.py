"""Opens a page in headless Chromium, with the network off, and tells what went wrong in it."""

import shutil
from contextlib import contextmanager

import pytest

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")


@contextmanager
def short_temporary_folder():
    """Chromium puts a socket there, whose path has at most 107 characters."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TMPDIR", "/tmp")
        yield


@contextmanager
def opened(path, *, dark=False, width=1200, height=900):
    """The page of a file; leaving it asserts that it logged no error and asked for nothing outside."""
    from playwright.sync_api import sync_playwright

    problems, requests = [], []
    with short_temporary_folder(), sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        context = browser.new_context(
            offline=True,
            color_scheme="dark" if dark else "light",
            viewport={"width": width, "height": height},
        )
        page = context.new_page()
        page.on(
            "console", lambda m: problems.append(m.text) if m.type in ("error", "warning") else None
        )
        page.on("pageerror", lambda error: problems.append(str(error)))
        page.on("request", lambda request: requests.append(request.url))
        page.goto(path.resolve().as_uri())
        page.wait_for_load_state("load")
        yield page
        browser.close()
    assert not problems, problems
    outside = [url for url in requests if not url.startswith(("file:", "data:", "blob:"))]
    assert not outside, outside
