"""A headless Chromium to open pages in, by its DevTools protocol; for tests only."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
PATIENCE = 30.0
"""Seconds that a start, a page or an answer may take."""


def program() -> str:
    """Where Chromium is; skips the test where there is none."""
    found = next((p for n in NAMES if (p := shutil.which(n))), None)
    if found is None:
        pytest.skip(f"no Chromium here: none of {', '.join(NAMES)} is installed")
    return found


class Browser:
    """One Chromium with a profile of its own in `home`, which must be empty."""

    def __init__(self, home: Path):
        websocket = pytest.importorskip("websocket")
        flags = ("--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run",
                 "--disable-dev-shm-usage", "--remote-debugging-port=0",
                 "--host-resolver-rules=MAP * ~NOTFOUND")  # fmt: skip
        self.process = subprocess.Popen(
            [program(), *flags, f"--user-data-dir={home}", "about:blank"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        try:
            port, path = self._address(home / "DevToolsActivePort")
            self.socket = websocket.create_connection(
                f"ws://127.0.0.1:{port}{path}", PATIENCE, suppress_origin=True
            )
        except BaseException:
            self.close()
            raise
        self.count = 0
        self.events: list[dict[str, Any]] = []

    def _address(self, file: Path) -> list[str]:
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            lines = file.read_text().split() if file.exists() else []
            if len(lines) == 2:
                return lines
            if self.process.poll() is not None:
                break
            time.sleep(0.05)
        raise RuntimeError(f"Chromium did not start in {PATIENCE:g} s")

    def close(self) -> None:
        """End Chromium and all that it started."""
        if hasattr(self, "socket"):
            self.socket.close()
        if self.process.poll() is None:
            os.killpg(self.process.pid, 9)
        self.process.wait(PATIENCE)

    def _hear(self) -> dict[str, Any]:
        said = json.loads(self.socket.recv())
        if "method" in said:
            self.events.append(said)
        return said

    def call(self, method: str, session: str | None = None, **params: Any) -> Any:
        """The answer to one command."""
        self.count += 1
        asked = {"id": self.count, "method": method, "params": params}
        self.socket.send(
            json.dumps(asked | ({"sessionId": session} if session else {}))
        )
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            said = self._hear()
            if said.get("id") == asked["id"]:
                if "error" in said:
                    raise RuntimeError(f"{method}: {said['error']['message']}")
                return said["result"]
        raise TimeoutError(f"{method} had no answer in {PATIENCE:g} s")

    def wait(self, method: str, session: str) -> None:
        """Until an event of a page has come."""
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            if any(True for _ in self.heard(session, method)):
                return
            self._hear()
        raise TimeoutError(f"{method} did not come in {PATIENCE:g} s")

    def heard(self, session: str, method: str) -> Any:
        """What events of a page said so far."""
        for event in self.events:
            if event.get("sessionId") == session and event["method"] == method:
                yield event["params"]


class Page:
    """A page open in a tab of its own, `width` pixels wide."""

    def __init__(self, browser: Browser, file: Path, width: int, scripts: bool = True):
        self.browser = browser
        tab = browser.call("Target.createTarget", url="about:blank")
        given = browser.call(
            "Target.attachToTarget", targetId=tab["targetId"], flatten=True
        )
        self.session, self.target = given["sessionId"], tab["targetId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")
        if not scripts:
            self.call("Emulation.setScriptExecutionDisabled", value=True)
        self.widen(width)
        self.address = file.as_uri()
        self.call("Page.navigate", url=self.address)
        browser.wait("Page.loadEventFired", self.session)

    def call(self, method: str, **params: Any) -> Any:
        return self.browser.call(method, self.session, **params)

    def close(self) -> None:
        """Close the tab."""
        self.browser.call("Target.closeTarget", targetId=self.target)

    def widen(self, width: int) -> None:
        """Make the screen `width` pixels wide: a phone's, if that is narrow."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width, height=900, deviceScaleFactor=1, mobile=width < 600,
        )  # fmt: skip

    def ask(self, code: str) -> Any:
        """The value of an expression of JavaScript, awaited."""
        said = self.call(
            "Runtime.evaluate", expression=code, returnByValue=True, awaitPromise=True
        )
        if "exceptionDetails" in said:
            raise RuntimeError(f"{code}: {said['exceptionDetails']}")
        return said["result"].get("value")

    def settle(self) -> None:
        """Until what was asked for is drawn."""
        self.ask(
            "new Promise(done => requestAnimationFrame(() => "
            "requestAnimationFrame(() => done())))"
        )

    def press(self, key: str) -> None:
        """One key, on what has the focus."""
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=key)
        self.settle()

    def click(self, selector: str) -> None:
        """What a click does, without the mouse."""
        self.ask(f"document.querySelector({json.dumps(selector)}).click()")
        self.settle()

    def errors(self) -> list[str]:
        """What the console holds of errors, and exceptions that nothing caught."""
        heard = self.browser.heard
        logged = (e["entry"] for e in heard(self.session, "Log.entryAdded"))
        said = [e["text"] for e in logged if e["level"] == "error"]
        for call in heard(self.session, "Runtime.consoleAPICalled"):
            if call["type"] in ("error", "assert"):
                said.append(str(call["args"]))
        thrown = heard(self.session, "Runtime.exceptionThrown")
        return said + [str(e["exceptionDetails"]) for e in thrown]

    def requests(self) -> list[str]:
        """Addresses that were asked for, but the page itself and inline data."""
        sent = self.browser.heard(self.session, "Network.requestWillBeSent")
        asked = [e["request"]["url"] for e in sent]
        return [a for a in asked if a != self.address and not a.startswith("data:")]

    def overflow(self) -> int:
        """Pixels by which the page is wider than its window."""
        return self.ask(
            "(e => e.scrollWidth - e.clientWidth)(document.documentElement)"
        )

    def cut(self) -> list[str]:
        """What is wider than its own frame, so that a part of it is out of sight."""
        return self.ask(
            "[...document.querySelectorAll('.scroll, .card')]"
            ".filter(e => e.scrollWidth > e.clientWidth + 1)"
            ".map(e => e.textContent.trim().slice(0, 60) || e.innerHTML.slice(0, 60))"
        )

    def pictures(self) -> list[tuple[str, int]]:
        """Alternative text and own width of every picture."""
        return self.ask("[...document.images].map(i => [i.alt.trim(), i.naturalWidth])")
