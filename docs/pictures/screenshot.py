#!/usr/bin/env python3
"""Takes status-light.png and status-dark.png beside this file: the status page of a relay at work.

    python3 docs/pictures/screenshot.py target/release/pnet-nat

Starts simulated nodes, the relay, a client that polls and a stranger with a wrong password, all on loopback.
Node 3 is switched off, so that it is silent. Needs chromium and chromedriver, as .ci/run installs them.
"""
import base64
import json
import os
import re
import subprocess
import sys
import tempfile
import time
import urllib.request
from contextlib import ExitStack
from pathlib import Path

LISTEN, SUBNET, ADMIN = "127.77.17.250", "127.77.17.", "127.77.17.250:9378"
WIDTH, HEIGHT = 1280, 1000
SECONDS = 200 # for the lines of the plots to have a shape
CONFIGURATION = f"""
[public]
listen = ["{LISTEN}"]
[runtime]
workers = 1
[admin]
listen = "{ADMIN}"
[[udp_range_net]]
name = "section-1"
start_port = 20000
subnet = "{SUBNET}0"
nodes = ["1-4", 33]
allow = ["127.0.0.0/8"]
[[udp_range_net.password]]
name = "service"
file = "section-1"
"""


def main(program):
    # All of it is on this machine.
    urllib.request.install_opener(urllib.request.build_opener(urllib.request.ProxyHandler({})))
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        for name, password in (("section-1", b"k7Zq+4Lx"), ("wrong", b"X9!wrong")):
            with open(os.open(folder / name, os.O_CREAT | os.O_WRONLY, 0o600), "wb") as file:
                file.write(password)
        (folder / "pnet-nat.toml").write_text(CONFIGURATION)

        def start(*arguments):
            process = subprocess.Popen([program, *arguments], cwd=folder, stdout=subprocess.DEVNULL,
                                       stderr=subprocess.DEVNULL)
            stack.callback(stop, process)
            return process

        def node(first, delay):
            return start("node", "--listen", f"{SUBNET}{first}", "--password-file", "section-1", "--delay", delay)

        def ask(nodes, password, interval):
            start("request", "--to", LISTEN, "--start-port", "20000", "--node", nodes, "--password-file", password,
                  "--count", "100000", "--interval", interval, "--timeout", "200ms")

        nodes = [node(1, "3ms"), node(2, "8ms"), node(3, "5ms"), node(4, "21ms")]
        start("run", "--config", "pnet-nat.toml")
        wait_for(lambda: get(f"http://{ADMIN}/-/ready"))
        browser = Browser(stack)
        browser.open(f"http://{ADMIN}/")
        ask("1-4", "section-1", "100ms")
        ask("4", "section-1", "50ms")
        time.sleep(SECONDS)
        ask("2", "wrong", "1s")
        stop(nodes[2])
        time.sleep(25)
        for scheme in ("light", "dark"):
            browser.screenshot(scheme, Path(__file__).with_name(f"status-{scheme}.png"))


class Browser:
    """Chromium, told what to do over WebDriver."""

    def __init__(self, stack):
        driver = subprocess.Popen(["chromedriver", "--port=0"], stdout=subprocess.PIPE, text=True)
        stack.callback(stop, driver)
        port = next(found[1] for line in driver.stdout if (found := re.search(r"on port (\d+)\.", line)))
        arguments = ["--headless=new", "--no-sandbox", "--disable-dev-shm-usage"] # root has no sandbox of Chromium's
        options = {"capabilities": {"alwaysMatch": {"goog:chromeOptions": {"args": arguments}}}}
        self.session = f"http://127.0.0.1:{port}/session"
        self.session += "/" + post(self.session, options)["sessionId"]
        stack.callback(lambda: urllib.request.urlopen(urllib.request.Request(self.session, method="DELETE")))

    def open(self, url):
        self.devtools("Emulation.setScrollbarsHidden", {"hidden": True})
        self.look("light")
        post(f"{self.session}/url", {"url": url})

    def look(self, scheme):
        self.devtools("Emulation.setDeviceMetricsOverride",
                      {"width": WIDTH, "height": HEIGHT, "deviceScaleFactor": 1, "mobile": False})
        feature = {"name": "prefers-color-scheme", "value": scheme}
        self.devtools("Emulation.setEmulatedMedia", {"features": [feature]})

    def screenshot(self, scheme, path):
        self.look(scheme)
        time.sleep(3) # until it is drawn anew
        path.write_bytes(base64.b64decode(self.devtools("Page.captureScreenshot", {})["data"]))
        print(path, path.stat().st_size)

    def devtools(self, command, parameters):
        return post(f"{self.session}/goog/cdp/execute", {"cmd": command, "params": parameters})


def get(url):
    with urllib.request.urlopen(url, timeout=5) as answer:
        return answer.read()


def post(url, body):
    request = urllib.request.Request(url, json.dumps(body).encode(), {"Content-Type": "application/json"})
    with urllib.request.urlopen(request, timeout=60) as answer:
        return json.load(answer)["value"]


def wait_for(probe):
    for _ in range(100):
        try:
            return probe()
        except OSError:
            time.sleep(0.1)
    sys.exit("the relay is not ready within 10 s")


def stop(process):
    process.terminate()
    process.wait()


if __name__ == "__main__":
    main(os.path.abspath(sys.argv[1]))
