"""A headless Chromium, driven through its debugging pipe: what a page loads, says and
shows.

`python -m tests.unit.report.browser PAGE.html FOLDER` makes the pictures of the docs.
"""

import base64
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
    "--remote-debugging-pipe",
)
Message = dict[str, Any]


@dataclass
class Tab:
    """One page of a running browser, with all its requests and complaints."""

    to: int
    back: int
    session: str = ""
    requests: list[str] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)
    _buffer: bytes = b""
    _count: int = 0

    def call(self, method: str, **parameters: object) -> Message:
        self._count += 1
        message: Message = {"id": self._count, "method": method, "params": parameters}
        if self.session:
            message["sessionId"] = self.session
        os.write(self.to, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == self._count:
                assert "error" not in answer, answer
                return dict(answer["result"])
            self._note(answer)

    def open(
        self, path: Path, *, width: int, height: int = 900, dark: bool = False
    ) -> None:
        """Load a file as a screen of this size and theme shows it."""
        self.requests.clear()
        self.complaints.clear()
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=width < 600,
        )
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        still = {"name": "prefers-reduced-motion", "value": "reduce"}
        self.call("Emulation.setEmulatedMedia", features=[scheme, still])
        self.call("Page.navigate", url=path.resolve().as_uri())
        event: Message = {}
        while event.get("method") != "Page.loadEventFired":
            event = self._next()
            self._note(event)

    def run(self, script: str) -> Any:
        answer = self.call(
            "Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def _next(self) -> Message:
        while b"\0" not in self._buffer:
            part = os.read(self.back, 1 << 16)
            assert part, "the browser has gone"
            self._buffer += part
        text, _, self._buffer = self._buffer.partition(b"\0")
        return dict(json.loads(text))

    def _note(self, message: Message) -> None:
        method = message.get("method")
        parameters = message.get("params", {})
        if method == "Network.requestWillBeSent":
            self.requests.append(parameters["request"]["url"])
        elif method == "Runtime.exceptionThrown":
            self.complaints.append(str(parameters["exceptionDetails"]))
        elif method == "Runtime.consoleAPICalled" and parameters["type"] in (
            "error",
            "warning",
        ):
            self.complaints.append(str(parameters["args"]))
        elif method == "Log.entryAdded" and parameters["entry"]["level"] != "verbose":
            self.complaints.append(parameters["entry"]["text"])


@contextmanager
def browsing(profile: Path) -> Iterator[Tab]:
    """Run a browser with a fresh profile.

    Where there is none the test is skipped, or fails if SEQID_BROWSER is set: who knows
    that a browser is installed does not want its tests to be passed over.
    """
    program = next(filter(None, map(shutil.which, NAMES)), None)
    if program is None:
        missing = f"no browser on the PATH: {', '.join(NAMES)}"
        if os.environ.get("SEQID_BROWSER"):
            pytest.fail(f"{missing}, though SEQID_BROWSER says that one is installed")
        pytest.skip(missing)
    theirs, to = os.pipe()
    back, ours = os.pipe()
    # The browser reads commands from descriptor 3 and answers on 4.
    shell = f'exec 3<&{theirs} 4>&{ours}; exec "$0" "$@"'
    process = subprocess.Popen(
        ["/bin/bash", "-c", shell, program, *FLAGS, f"--user-data-dir={profile}"],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        pass_fds=(theirs, ours),
    )
    os.close(theirs)
    os.close(ours)
    try:
        tab = Tab(to, back)
        target = tab.call("Target.createTarget", url="about:blank")["targetId"]
        attached = tab.call("Target.attachToTarget", targetId=target, flatten=True)
        tab.session = attached["sessionId"]
        for domain in ("Page", "Network", "Runtime", "Log"):
            tab.call(f"{domain}.enable")
        yield tab
    finally:
        process.terminate()
        process.wait(timeout=20)
        os.close(to)
        os.close(back)


def main(page: Path, folder: Path) -> None:
    """Write what a screen, a phone and a sheet of paper show of a report."""
    views = {  # name: width and height of the screen, part to show
        "report": (1280, 860, "#verdict"),
        "report_dark": (1280, 560, "#torque-2"),
        "report_phone": (400, 800, "#torque-2"),
        "report_print": (760, 1000, "#verdict"),
    }
    with tempfile.TemporaryDirectory() as profile, browsing(Path(profile)) as tab:
        for name, (width, height, part) in views.items():
            tab.open(page, width=width, height=height, dark=name == "report_dark")
            if name == "report_print":
                tab.call("Emulation.setEmulatedMedia", media="print")
            top = (
                "0"
                if part == "#verdict"
                else f"document.querySelector('{part}').offsetTop - 60"
            )
            tab.run(f"scrollTo(0, {top})")
            picture = tab.call("Page.captureScreenshot", format="png")
            (folder / f"{name}.png").write_bytes(base64.b64decode(picture["data"]))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
