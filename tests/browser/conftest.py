"""Fixtures of the browser tests: a browser, pages that must be silent, and the server of `magline view`."""

import os
import re
import subprocess
import threading
from pathlib import Path

import pytest
from playwright.sync_api import sync_playwright

FOLDER = Path(os.environ.get("REPORTS", "."))


@pytest.fixture(scope="session")
def browser():
    with sync_playwright() as playwright:
        made = playwright.chromium.launch(executable_path=os.environ["CHROMIUM"], args=["--no-sandbox"])
        yield made
        made.close()


@pytest.fixture
def visit(browser):
    """Opens a file or an address. At the end: no message on the console and no request to another origin."""
    faults, contexts = [], []

    def visit(place, width=1400, scheme="light", motion="no-preference", trusted=False):
        # A trusted page takes styles from the test.
        context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme,
                                      reduced_motion=motion, bypass_csp=trusted)
        # A busy machine is slow.
        context.set_default_timeout(90_000)
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda m: faults.append(m.text) if m.type in ("error", "warning") else None)
        page.on("pageerror", lambda e: faults.append(str(e)))
        served = str(place).startswith("http")
        address = str(place) if served else Path(place).as_uri()
        inner = ("data:", "blob:", address.split("#")[0])
        page.on("request", lambda r: faults.append(r.url) if not r.url.startswith(inner) else None)
        page.goto(address)
        return page

    yield visit
    for context in contexts:
        context.close()
    assert faults == []


class Served:
    """A server of `magline view`."""

    def __init__(self, *source):
        program = [os.environ["MAGLINE"], "view", *map(str, source)]
        self.process = subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        self.address = None
        for line in self.process.stdout:
            found = re.search(r"http://127\.0\.0\.1:\d+/\S+", line)
            if found:
                self.address = found[0]
                break
        # A full pipe would stop the server.
        threading.Thread(target=self.process.stdout.read, daemon=True).start()

    def stop(self):
        self.process.terminate()
        self.process.wait(10)


@pytest.fixture(scope="session")
def view():
    """Starts the server of a spec or a store in the folder of the reports, and returns its address."""
    known = {}

    def view(name):
        # A server that runs already.
        running = os.environ.get("VIEW_AT_" + name.upper())
        if running:
            return running
        if name not in known:
            spec = FOLDER / f"{name}.toml"
            # A folder without a spec is a store of several pipelines.
            known[name] = Served(spec, "--set", f"store={FOLDER / name}") if spec.exists() else Served(FOLDER / name)
            assert known[name].address, f"magline view {name} printed no address"
        return known[name].address

    yield view
    for served in known.values():
        served.stop()


def download(page, button):
    """Bytes that a button saves."""
    with page.expect_download() as waiting:
        button.click()
    return Path(waiting.value.path()).read_bytes()


def until(page, script, arg=None, seconds=60):
    """Waits until a script returns a true value. The policy of the view forbids `wait_for_function`."""
    for _ in range(int(seconds * 20)):
        if page.evaluate(script, arg):
            return
        page.wait_for_timeout(50)
    raise AssertionError(f"never true: {script}")


def line_view(page):
    """The line view, when its panels are drawn."""
    page.locator("#series .charts .chart canvas").first.wait_for()
    until(page, "document.querySelector('#series [role=status]').textContent.includes('samples')")
    return page.locator("#series")


def shown(page):
    """First and last time in sight, s."""
    return [float(t) for t in page.locator("#series .charts").get_attribute("data-shown").split()]
