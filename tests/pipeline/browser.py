"""Chromium without a window, spoken to over a pipe: the DevTools protocol needs no port and no library then."""

import base64
import itertools
import json
import os
import select
import shutil
import subprocess
import time

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
SWITCHES = (
    "--headless",
    "--remote-debugging-pipe",
    "--no-sandbox",  # root, as in containers, has none
    "--disable-gpu",
    "--disable-dev-shm-usage",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--host-resolver-rules=MAP * ~NOTFOUND",
    "--autoplay-policy=no-user-gesture-required",
)


def find():
    """The path of a Chromium, or None."""
    return next(filter(None, map(shutil.which, NAMES)), None)


class Browser:
    """One page in a Chromium of its own.

    Attributes:
        messages: what the page wrote to the console, and errors.
        requests: addresses that the page asked for.
    """

    def __init__(self, program, profile):
        to_browser, self._out = os.pipe()
        self._in, from_browser = os.pipe()

        def place():  # Chromium reads from 3 and writes to 4
            os.dup2(os.dup2(to_browser, 100), 3)
            os.dup2(os.dup2(from_browser, 101), 4)

        command = [program, *SWITCHES, f"--user-data-dir={profile}", "about:blank"]
        # The pipes' own numbers may be 3 or 4, so the child takes copies, and 3 and 4 stay open in it.
        self._log = open(profile / "chromium.log", "wb")  # noqa: SIM115
        self._process = subprocess.Popen(command, stderr=self._log, stdout=self._log, close_fds=False, preexec_fn=place)
        os.close(to_browser)
        os.close(from_browser)
        self._numbers, self._received, self._session = itertools.count(1), b"", None
        self.messages, self.requests, self._loaded = [], [], False
        target = self("Target.createTarget", url="about:blank")["targetId"]
        self._session = self("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self(f"{domain}.enable")

    def __call__(self, method, **parameters):
        """Send one command and wait for its result."""
        number = next(self._numbers)
        message = {"id": number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        data = json.dumps(message).encode() + b"\0"
        while data:
            data = data[os.write(self._out, data) :]
        while True:
            answer = self._next()
            if answer.get("id") == number:
                assert "error" not in answer, (method, answer)
                return answer["result"]

    def open(self, path, width=1200, height=900, dark=False):
        """Load a local file in a window of a size, and wait until it has loaded."""
        self("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 600)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self("Emulation.setEmulatedMedia", features=[scheme])
        self._loaded = False
        self("Page.navigate", url=path.as_uri())
        while not self._loaded:
            self._next()

    def run(self, expression):
        """The value of a JavaScript expression; a promise's once it has one."""
        done = self("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True, userGesture=True)
        assert "exceptionDetails" not in done, done
        return done["result"].get("value")

    def picture(self, path, whole=False):
        """Save what the window shows, or the whole page, as PNG."""
        data = self("Page.captureScreenshot", captureBeyondViewport=whole)["data"]
        path.write_bytes(base64.b64decode(data))

    def close(self):
        os.close(self._out)  # Chromium ends with its pipe
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
        os.close(self._in)
        self._log.close()

    def _next(self, seconds=60):
        """The next message, noted if it is an event."""
        end = time.monotonic() + seconds
        while b"\0" not in self._received:
            ready, _, _ = select.select([self._in], [], [], max(0, end - time.monotonic()))
            part = os.read(self._in, 1 << 20) if ready else b""
            assert part, "Chromium says nothing"
            self._received += part
        message, self._received = self._received.split(b"\0", 1)
        answer = json.loads(message)
        event, details = answer.get("method"), answer.get("params", {})
        if event == "Runtime.consoleAPICalled":
            self.messages.append(" ".join(str(part.get("value", part)) for part in details["args"]))
        elif event == "Runtime.exceptionThrown":
            self.messages.append(str(details["exceptionDetails"]))
        elif event == "Log.entryAdded":
            self.messages.append(details["entry"]["text"])
        elif event == "Network.requestWillBeSent":
            self.requests.append(details["request"]["url"])
        elif event == "Page.loadEventFired":
            self._loaded = True
        return answer
