"""A headless Chromium for tests: opens a file and says what happened. It never goes to the network."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import pytest
from playwright.sync_api import BrowserContext, Page, Playwright, Request, Route, sync_playwright

FLAGS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]


@dataclass
class Visit:
    """An open page, and what it asked for and complained of."""

    page: Page
    requests: list[str] = field(default_factory=list)
    """Requests for anything but the file itself and data inside it."""
    complaints: list[str] = field(default_factory=list)
    """Errors and warnings on the console, and uncaught exceptions."""


def chromium_path() -> str:
    """Where Chromium is; without it the test is skipped, but under CI it fails: there it must not be missing."""
    result = shutil.which("chromium") or shutil.which("chromium-browser")
    if result is None:
        message = "no chromium on this machine; on Debian: apt-get install chromium"
        if os.environ.get("CI"):
            pytest.fail(message)
        pytest.skip(message)
    return result


@contextmanager
def chromium(profile: Path, *, scripts: bool = True, driver: Playwright | None = None) -> Iterator[BrowserContext]:
    """A browser with a new, empty profile.

    Parameters
    ----------
    profile
        A folder that does not exist yet or is empty.
    scripts
        False turns JavaScript off, for the page but not for the test.
    driver
        What starts the browser, for a second one beside another: there is one of them in a thread.
    """
    with nullcontext(driver) if driver else sync_playwright() as starter:
        context = starter.chromium.launch_persistent_context(
            profile, executable_path=chromium_path(), headless=True, args=FLAGS, java_script_enabled=scripts
        )
        try:
            yield context
        finally:
            context.close()


def visit(
    context: BrowserContext, file: Path, *, width: int, height: int = 900, scheme: Literal["light", "dark"] = "light"
) -> Visit:
    """Open a file in a window of some CSS pixels; whatever it asks of a network is noted and refused."""
    page = context.new_page()
    page.emulate_media(color_scheme=scheme)
    page.set_viewport_size({"width": width, "height": height})
    visited = Visit(page)

    def answer(route: Route, request: Request) -> None:
        if request.url == file.as_uri() or request.url.startswith("data:"):
            route.continue_()
        else:
            visited.requests.append(request.url)
            route.abort()

    page.route("**/*", answer)
    page.on("console", lambda message: message.type in {"error", "warning"} and visited.complaints.append(message.text))
    page.on("pageerror", lambda error: visited.complaints.append(str(error)))
    page.goto(file.as_uri(), wait_until="load")
    return visited
