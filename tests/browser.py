"""A headless Chromium that tests talk to over a pipe (the DevTools protocol), no driver or port needed."""

import base64
import io
import json
import os
import re
import select
import shutil
import subprocess
import tempfile
import time
from html import unescape
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    "--headless=new", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--no-first-run", "--disable-extensions", "--disable-background-networking", "--hide-scrollbars",
    "--remote-debugging-pipe", "--window-size=1000,900", "--disable-dev-shm-usage",
)  # fmt: skip
PATIENCE = 60.0  # s: a browser on a busy machine


class Browser:
    """One page. `problems`: what the page's console, errors and refused loads told."""

    def __init__(self):
        program = next(filter(None, map(shutil.which, PROGRAMS)), None)
        if program is None:
            pytest.skip("needs a browser: apt-get install chromium")
        self.profile = tempfile.mkdtemp()
        to_browser, self.to = os.pipe()
        self.of, from_browser = os.pipe()

        def ends():  # the browser reads file 3 and writes file 4
            a, b = os.dup(to_browser), os.dup(from_browser)
            os.dup2(a, 3)
            os.dup2(b, 4)

        self.process = subprocess.Popen(
            [program, *FLAGS, f"--user-data-dir={self.profile}", "about:blank"],
            close_fds=False,
            preexec_fn=ends,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(to_browser)
        os.close(from_browser)
        self.count, self.rest, self.problems, self.session, self.requests = 0, b"", [], None, []
        target = next(t for t in self.tell("Target.getTargets")["targetInfos"] if t["type"] == "page")
        attached = self.tell("Target.attachToTarget", targetId=target["targetId"], flatten=True)
        self.session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.tell(f"{domain}.enable")

    def close(self):
        self.process.kill()
        self.process.wait()
        os.close(self.to)
        os.close(self.of)
        shutil.rmtree(self.profile, ignore_errors=True)

    def tell(self, method, **params):
        """Result of a command."""
        self.count += 1
        message = {"id": self.count, "method": method, "params": params}
        if self.session:
            message["sessionId"] = self.session
        os.write(self.to, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._read()
            if answer.get("id") == self.count:
                assert "error" not in answer, answer
                return answer["result"]
            self._note(answer)

    def _read(self):
        while b"\0" not in self.rest:
            assert select.select([self.of], [], [], PATIENCE)[0], "the browser does not answer"
            more = os.read(self.of, 1 << 20)
            assert more, "the browser ended"
            self.rest += more
        message, self.rest = self.rest.split(b"\0", 1)
        return json.loads(message)

    def _note(self, event):
        method, params = event.get("method"), event.get("params", {})
        if method == "Runtime.exceptionThrown":
            self.problems.append(str(params["exceptionDetails"]))
        elif method == "Log.entryAdded":
            self.problems.append(params["entry"]["text"])
        elif method == "Runtime.consoleAPICalled":
            self.problems.append(str(params["args"]))
        elif method == "Network.requestWillBeSent":
            self.requests.append(params["request"]["url"])

    def open(self, path: Path):
        """Loads a file as a double click does, and waits until it has drawn."""
        self.problems.clear()
        self.requests.clear()
        self.tell("Page.navigate", url=path.resolve().as_uri())
        end = time.monotonic() + PATIENCE
        while self.value("document.documentElement?.dataset.ready") != "yes":
            told = self.value("document.getElementById('message')?.textContent ?? ''")
            assert "cannot be drawn" not in told, (told, self.problems)
            assert time.monotonic() < end, (told, self.problems)
            time.sleep(0.05)
        self.drawn()

    def value(self, expression):
        """Of an expression in the page; promises are waited for."""
        made = self.tell("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in made, made
        return made["result"].get("value")

    def drawn(self):
        """Waits for two frames: what was asked for is on the screen after them."""
        self.value("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(1))))")

    def box(self, selector):
        return self.value(
            f"(b => [b.left, b.top, b.width, b.height])(document.querySelector('{selector}').getBoundingClientRect())"
        )

    def mouse(self, kind, x, y, **more):
        self.tell("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1, **more)

    def drag(self, begin, end):
        """From one point of the window to another with the left button down."""
        self.mouse("mousePressed", *begin, buttons=1)
        for share in np.linspace(0, 1, 6)[1:]:
            self.mouse("mouseMoved", *(np.array(begin) + share * np.subtract(end, begin)), buttons=1)
        self.mouse("mouseReleased", *end)
        self.drawn()

    def click(self, x, y):
        self.drag((x, y), (x, y))

    def press(self, key, code):
        for kind in ("rawKeyDown", "keyUp"):
            self.tell("Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=code)
        self.drawn()

    def choose(self, selector, value):
        """An entry of a list."""
        self.value(
            f"(s => {{ s.value = '{value}'; s.dispatchEvent(new Event('change')); }})"
            f"(document.querySelector('{selector}'))"
        )
        self.drawn()

    def picture(self, selector):
        """(height, width, 3) of an element as it is on the screen."""
        x, y, width, height = self.box(selector)
        clip = {"x": x, "y": y, "width": width, "height": height, "scale": 1}
        shot = self.tell("Page.captureScreenshot", clip=clip, captureBeyondViewport=True)["data"]
        return np.asarray(Image.open(io.BytesIO(base64.b64decode(shot))).convert("RGB")).astype(int)


def coloured(picture):
    """Share of the picture that has colours of its own, not greys."""
    return (np.ptp(picture, axis=2) > 30).mean()


def change(before, after):
    return np.abs(before - after).mean()


def meta_of(page):
    """What a page's script reads; the page fetches nothing."""
    text = page.read_text()
    assert not re.search(r"(src|href)=[^#]{2}", re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL))
    return json.loads(unescape(re.search(r'id="page-data">(.*?)</script>', text, re.DOTALL)[1]))
