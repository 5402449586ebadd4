#!/usr/bin/env python3
"""How long a probe waits while many scrape a large relay, and what that costs.

    taskset -c 1 python3 benches/scrapes.py BINARY [BINARY ...]

Each relay has 64 nets of 125 nodes on loopback and runs on core 0 alone. So many scrapers as said read
/metrics over and over; beside them /-/ready is asked 20 times a second."""

import http.client, os, subprocess, sys, tempfile, threading, time

NETS, SECONDS, ADMIN = 64, 6, ("127.77.7.200", 9378)


def configuration(folder):
    secret = os.path.join(folder, "secret")
    with open(os.open(secret, os.O_CREAT | os.O_WRONLY, 0o600), "wb") as file:
        file.write(b"x9!Kd-2q")
    net = ('[[udp_range_net]]\nname = "n{0}"\nstart_port = {1}\nsubnet = "127.78.{0}.0"\n'
           'nodes = ["1-125"]\nallow = ["127.0.0.0/8"]\n'
           '[[udp_range_net.password]]\nname = "service"\nfile = "secret"\n')
    nets = "".join(net.format(i, 20000 + 130 * i) for i in range(NETS))
    path = os.path.join(folder, "pnet-nat.toml")
    with open(path, "w") as file:
        file.write(f'[public]\nlisten = ["{ADMIN[0]}"]\n[runtime]\nworkers = 1\n'
                   f'[admin]\nlisten = "{ADMIN[0]}:{ADMIN[1]}"\n{nets}')
    return path


def get(path, headers={}, timeout=60):
    connection = http.client.HTTPConnection(*ADMIN, timeout=timeout)
    try:
        connection.request("GET", path, headers=headers)
        answer = connection.getresponse()
        octets = 0
        while piece := answer.read(1 << 16):
            octets += len(piece)
        return answer.status, octets
    finally:
        connection.close()


def resident(pid):
    with open(f"/proc/{pid}/statm") as file:
        return int(file.read().split()[1]) * 4096 / 1e6


def load(pid, scrapers, headers):
    over, done, failed, most = threading.Event(), [], [], [0.0]

    def scrape():
        while not over.is_set():
            try:
                done.append(get("/metrics", headers)[1])
            except Exception as error:
                failed.append(error)

    threads = [threading.Thread(target=scrape, daemon=True) for _ in range(scrapers)]
    for thread in threads:
        thread.start()
    waits, until = [], time.monotonic() + SECONDS
    while time.monotonic() < until:
        began = time.monotonic()
        try:
            get("/-/ready", timeout=20)
        except Exception:
            pass
        waits.append(time.monotonic() - began)
        most[0] = max(most[0], resident(pid))
        time.sleep(0.05)
    over.set()
    for thread in threads:
        thread.join()
    waits.sort()
    return (f"{scrapers:>3} scrapers{' gzip' if headers else '     '}: probe median "
            f"{1e3 * waits[len(waits) // 2]:.1f} ms, worst {1e3 * waits[-1]:.1f} ms; "
            f"{len(done)} scrapes, {len(failed)} failed; {most[0]:.0f} MB resident")


for binary in sys.argv[1:]:
    with tempfile.TemporaryDirectory() as folder:
        command = f"ulimit -n 20000; exec taskset -c 0 {binary} run --config {configuration(folder)}"
        relay = subprocess.Popen(["bash", "-c", command], stderr=subprocess.DEVNULL)
        try:
            while True:
                try:
                    if get("/-/ready")[0] == 200:
                        break
                except OSError:
                    time.sleep(0.1)
            print(f"{binary}: {resident(relay.pid):.0f} MB resident before")
            for scrapers in (1, 16, 64):
                for headers in ({}, {"Accept-Encoding": "gzip"}):
                    print(load(relay.pid, scrapers, headers), flush=True)
        finally:
            relay.terminate()
            relay.wait()
