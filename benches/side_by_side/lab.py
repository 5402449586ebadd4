"""Three network namespaces on this machine, the processes in them, and what they cost.

    inet (clients) --veth-- edge (system under test) --veth-- plant (nodes)
    198.51.100.2     198.51.100.1            172.17.17.254   172.17.17.1 ...

Nothing else on the machine or the network is touched. The namespaces carry this process's id in
their names and are gone when it ends.
"""
import json
import os
import shutil
import signal
import subprocess
import tempfile
import time

HERE = os.path.dirname(os.path.abspath(__file__))
ROOT = os.path.dirname(os.path.dirname(HERE))
TARGET = os.path.join(ROOT, "target")
PUBLIC, CLIENT = "198.51.100.1", "198.51.100.2"
SERVER_PORT = 34379
NAMESPACES = {place: f"bench-{os.getpid()}-{place}" for place in ("inet", "edge", "plant")}
OWN = {"pnet-nat": "release", "loadgen": "side_by_side/release", "idealrelay": "side_by_side/release"}
TICKS = os.sysconf("SC_CLK_TCK")


def find(name):
    """Path of a program: this project's own build, or else of the system; None when it is missing."""
    if name in OWN:
        path = os.path.join(TARGET, OWN[name], name)
        return path if os.access(path, os.X_OK) else None
    return shutil.which(name) or shutil.which(name, path="/usr/local/sbin:/usr/sbin:/sbin")


def build():
    """Builds the relay and the load generator."""
    own = ["cargo", "build", "--release", "--locked", "--target-dir"]
    subprocess.run([*own, TARGET], cwd=ROOT, check=True)
    loadgen = ["--manifest-path", os.path.join(HERE, "loadgen", "Cargo.toml")]
    subprocess.run([*own, os.path.join(TARGET, "side_by_side"), *loadgen], check=True)


def shell(command):
    done = subprocess.run(command, shell=True, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{command}: {done.stderr.strip() or done.stdout.strip()}")
    return done.stdout


def inside(place, command):
    return [find("ip"), "netns", "exec", NAMESPACES[place], *command]


# ---- the network ----------------------------------------------------------------------------
def build_network(plant, forward=False):
    """Makes the namespaces anew. `plant` is a list of `ip` commands for the plant's side, with
    {edge} and {plant} for the namespaces. With `forward` the kernel routes between both sides."""
    remove_network()
    for namespace in NAMESPACES.values():
        shell(f"ip netns add {namespace}")
        shell(f"ip -n {namespace} link set lo up")
    commands = [
        "link add inet0 netns {inet} type veth peer name inet0 netns {edge}",
        "link add plant0 netns {edge} type veth peer name plant0 netns {plant}",
        f"-n {{inet}} addr add {CLIENT}/24 dev inet0",
        f"-n {{edge}} addr add {PUBLIC}/24 dev inet0",
        "-n {inet} link set inet0 up",
        "-n {edge} link set inet0 up",
        "-n {edge} link set plant0 up",
        "-n {plant} link set plant0 up",
        f"-n {{inet}} route add default via {PUBLIC}",
        *plant,
    ]
    for command in commands:
        shell("ip " + command.format(**NAMESPACES))
    shell(f"ip netns exec {NAMESPACES['edge']} sysctl -qw net.ipv4.ip_forward={int(forward)}")


def remove_network():
    there = shell("ip netns list").split()
    for namespace in NAMESPACES.values():
        if namespace in there:
            shell(f"ip netns del {namespace}")


# ---- processes ------------------------------------------------------------------------------
def pinned(cpus, command):
    return ["taskset", "-c", cpus, *command] if cpus else command


class System:
    """What is measured: the processes of one relay in `edge`, each in a session of its own."""

    def __init__(self, commands, folder, cpus=None):
        self.log = folder.path("log")
        with open(self.log, "w") as log:
            self.processes = [
                subprocess.Popen(inside("edge", pinned(cpus, command)), stdin=subprocess.DEVNULL,
                                 stdout=log, stderr=log, start_new_session=True)
                for command in commands]

    def members(self):
        """(process id, its figures from /proc) of all that belongs to it, children too."""
        sessions = {process.pid for process in self.processes}
        for name in os.listdir("/proc"):
            if not name.isdigit():
                continue
            try:
                with open(f"/proc/{name}/stat") as file:
                    figures = file.read().rsplit(")", 1)[1].split()
            except OSError:
                continue  # it has just ended
            if int(figures[3]) in sessions:
                yield int(name), figures

    def cpu(self):
        """Seconds of processor time so far, children that have ended included."""
        return sum(int(ticks) for _, figures in self.members() for ticks in figures[11:15]) / TICKS

    def memory(self):
        """Octets resident."""
        return sum(int(figures[21]) for _, figures in self.members()) * os.sysconf("SC_PAGE_SIZE")

    def has_ended(self):
        return any(process.poll() is not None for process in self.processes)

    def last_words(self):
        with open(self.log) as log:
            return log.read()[-500:]

    def stop(self):
        for stop in (signal.SIGTERM, signal.SIGKILL):
            for process, _ in self.members():
                try:
                    os.kill(process, stop)
                except ProcessLookupError:
                    pass
            end = time.monotonic() + 6
            while time.monotonic() < end:
                ended = [process.poll() is not None for process in self.processes]
                if all(ended) and all(figures[0] == "Z" for _, figures in self.members()):
                    return
                time.sleep(0.02)


class Nodes:
    """The simulated nodes in `plant`."""

    def __init__(self, cpus=None):
        command = [find("loadgen"), "node", "--port", str(SERVER_PORT)]
        self.process = subprocess.Popen(inside("plant", pinned(cpus, command)),
                                        stdout=subprocess.PIPE, text=True)

    def stop(self):
        """Ends them and returns what they counted."""
        self.process.terminate()
        try:
            return json.loads(self.process.communicate(timeout=5)[0])
        except subprocess.TimeoutExpired:
            self.process.kill()
            raise


class Load:
    """A load generator in `inet`."""

    def __init__(self, role, targets, options, cpus=None):
        command = [find("loadgen"), role, "--targets", targets, *map(str, options)]
        self.process = subprocess.Popen(inside("inet", pinned(cpus, command)), text=True,
                                        stdout=subprocess.PIPE, stderr=subprocess.PIPE)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()

    def wait_for(self, line):
        """Reads on until this line, or the end."""
        while (got := self.process.stdout.readline()) and got.strip() != line:
            pass

    def result(self):
        lines = self.process.stdout.read().splitlines()
        error = self.process.stderr.read()
        if self.process.wait() or not lines:
            raise RuntimeError(error.strip() or "no result")
        return json.loads(lines[-1])


def measure(system, load):
    """Waits for a client's measured part and returns its result, with the cost of those seconds."""
    load.wait_for("begin")
    cpu, busy, start = system.cpu(), machine_busy(), time.monotonic()
    load.wait_for("end")
    seconds = time.monotonic() - start
    cpu, busy = system.cpu() - cpu, machine_busy() - busy
    result = load.result()
    received = max(result["received"], 1)
    return {**result, "cpu": cpu / seconds, "busy": busy / seconds,
            "cpu_us": cpu * 1e6 / received, "busy_us": busy * 1e6 / received}


def wait_until_ready(system, targets, ports):
    """Ready when one request to each of these ports has come back, all of them in one try."""
    options = ["--sockets", ports, "--warm-up", 0.2, "--seconds", 0.3]
    result, end = None, time.monotonic() + 15
    while time.monotonic() < end and not system.has_ended():
        time.sleep(0.2)
        with Load("client", targets, options) as load:
            result = load.result()
        if result["received"] >= ports and result["lost"] == 0:
            time.sleep(0.3)
            return
    raise RuntimeError(f"not ready: {result} {system.last_words()}")


def machine_busy():
    """Seconds that all processors together were not idle, so far."""
    with open("/proc/stat") as file:
        user, nice, system, _idle, _wait, hard, soft = map(int, file.readline().split()[1:8])
    return (user + nice + system + hard + soft) / TICKS


def machine():
    """The machine and its kernel in a line."""
    with open("/proc/cpuinfo") as file:
        models = [line.split(":")[1].strip() for line in file if line.startswith("model name")]
    return f"Linux {os.uname().release}, {os.cpu_count()} cores ({models[0] if models else '?'})"


class Folder(tempfile.TemporaryDirectory):
    """A folder for a system's files. Others may enter it, for workers without privileges."""

    def __enter__(self):
        os.chmod(self.name, 0o755)
        return self

    def path(self, name):
        return os.path.join(self.name, name)

    def write(self, files):
        """{name: text}, readable by the owner alone, as passwords have to be."""
        for name, text in files.items():
            with open(self.path(name), "w") as file:
                file.write(text)
            os.chmod(self.path(name), 0o600)
