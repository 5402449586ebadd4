"""Tables of runs. Ratios are medians of the ratios within each round: the machine's own speed
drifts between rounds by more than most systems differ."""
from statistics import median, quantiles

# What the others are compared with.
YARDSTICKS = ("nginx", "ideal", "nft-nat")
# What has no process whose time could be told.
KERNEL = ("direct", "nft-nat")
ODD = ("wrong_node", "wrong_port", "foreign", "stale", "malformed")


def line(run):
    """One run in one line, while it goes."""
    head = f"round {run['round'] + 1} {run['scenario']:12} {run['system']:13}"
    if "error" in run:
        return f"{head} failed: {run['error'][:300]}"
    return (f"{head} {run['rate']:9,.0f}/s  lost {run['loss_percent']:.3f} %  p50 {number(run['p50_us'], 0)} "
            f"p99 {number(run['p99_us'], 0)} us  relay {run['cpu']:.3f} machine {run['busy']:.3f} cores")


def tables(runs, scenarios):
    """Everything, a table for each scenario."""
    out = []
    for name in scenarios:
        rows = {system: of(runs, system, name) for system in systems(runs)}
        rows = {system: runs for system, runs in rows.items() if runs}
        if rows:
            out += [f"\n**{name}**: {scenarios[name]['about']}\n", *scenario(rows), "", *compared(rows)]
    return "\n".join(out + failures(runs) + odd(runs))


def scenario(rows):
    head = ["system", "round trips/s (least..most)", "lost %", "p50 us", "p99 us", "p99.9 us",
            "relay, cores", "relay, us each", "machine, cores", "machine, us each"]
    yield from header(head)
    for system, runs in rows.items():
        rates = [run["rate"] for run in runs]
        relay = ["(kernel)"] * 2 if system in KERNEL else [
            number(middle(runs, "cpu"), 3), number(middle(runs, "cpu_us"), 2)]
        yield row([
            system, f"{median(rates):,.0f} ({min(rates):,.0f}..{max(rates):,.0f})",
            number(middle(runs, "loss_percent"), 3), number(middle(runs, "p50_us"), 1),
            number(middle(runs, "p99_us"), 0), number(middle(runs, "p999_us"), 0), *relay,
            number(middle(runs, "busy"), 3), number(middle(runs, "busy_us"), 2)])


def compared(rows):
    """Each system beside the yardsticks, as ratios, with the middle half of the rounds."""
    head = ["system", "of", "round trips/s", "relay, us each", "p50"]
    yield from header(head)
    for system, runs in rows.items():
        for other in YARDSTICKS:
            if other in rows and other != system:
                rate, cpu, p50 = (spread(ratios(runs, rows[other], key))
                                  for key in ("rate", "cpu_us", "p50_us"))
                yield row([system, other, rate, "(kernel)" if system in KERNEL else cpu, p50])


def readme(runs):
    """The one table that says most."""
    head = ["system", "throughput, of nginx", "thin flows, of nginx", "latency (p50), of nft-nat",
            "relay CPU at 30,000/s", "flood: good traffic lost", "flood: relay CPU",
            "flood: p99, of that without"]
    out = list(header(head))
    for system in systems(runs):
        own = {name: of(runs, system, name)
               for name in ("throughput", "thin", "latency", "open", "calm", "flood")}
        base = lambda name, scenario: of(runs, name, scenario)
        cores = lambda name: "(kernel)" if system in KERNEL else number(middle(own[name], "cpu"), 2, " core")
        out.append(row([
            system,
            ratio(own["throughput"], base("nginx", "throughput"), "rate", " ×"),
            ratio(own["thin"], base("nginx", "thin"), "rate", " ×"),
            ratio(own["latency"], base("nft-nat", "latency"), "p50_us", " ×"),
            cores("open"),
            number(middle(own["flood"], "loss_percent"), 1, " %"),
            cores("flood"),
            ratio(own["flood"], own["calm"], "p99_us", " ×")]))
    return "\n".join(out + failures(runs) + odd(runs))


def failures(runs):
    lines = [f"- {run['system']}, {run['scenario']}: {run['error'][:300]}"
             for run in runs if "error" in run]
    return ["\nFailed:\n", *lines] if lines else []


def odd(runs):
    """Answers at the wrong client, of the wrong port, requests at the wrong node."""
    lines = []
    for system in systems(runs):
        good = [run for run in runs if run["system"] == system and "error" not in run]
        counts = {what: sum(run[what] for run in good) for what in ODD}
        if any(counts.values()):
            told = ", ".join(f"{what} {count:,}" for what, count in counts.items() if count)
            lines.append(f"- {system}: {told} in {len(good)} runs")
    return ["\nDatagrams where they do not belong:\n", *lines] if lines else []


def systems(runs):
    return list(dict.fromkeys(run["system"] for run in runs))


def of(runs, system, scenario):
    return [run for run in runs if run["system"] == system and run["scenario"] == scenario
            and "error" not in run]


def middle(runs, key):
    values = [run[key] for run in runs if run[key] is not None]
    return median(values) if values else None


def ratios(runs, base, key):
    """Of each round that both ended; none where it would say nothing."""
    base = {run["round"]: run[key] for run in base or []}
    return [run[key] / base[run["round"]] for run in runs
            if run[key] is not None and base.get(run["round"])]


def ratio(runs, base, key, unit=""):
    found = ratios(runs, base, key)
    return number(median(found), 2, unit) if found else "-"


def spread(found):
    if len(found) < 2:
        return number(found[0] if found else None, 2)
    low, half, high = quantiles(found, n=4, method="inclusive")
    return f"{half:.2f} ({low:.2f}..{high:.2f})"


def number(value, digits, unit=""):
    return "-" if value is None else f"{value:,.{digits}f}{unit}"


def header(names):
    return row(names), "|---" * len(names) + "|"


def row(cells):
    return f"| {' | '.join(cells)} |"
