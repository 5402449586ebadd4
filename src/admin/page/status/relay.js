// ── The relay as a whole ────────────────────────────────────────────────────────────────────────

const RATES = { requests: new Rate(), dropped: new Rate(), passwords: new Rate() };
const TIMES = new Traffic();

function showTiles(time, status, states, dropped) {
  const sum = (of) => states.reduce((sum, state) => sum + of(state), 0);
  const answering = sum((net) => net.answering_nodes);
  const silent = sum((net) => net.silent_nodes.length);
  const never = sum((net) => net.never_asked_nodes);
  TILES.nodes.show(`${whole.format(answering)} of ${whole.format(status.public_ports)}`,
    `${whole.format(silent)} silent, ${whole.format(never)} never asked`);
  TILES.nodes.add(time, answering);

  const direction = (name) => ({
    forwarded_datagrams: sum((net) => net[name].forwarded_datagrams),
  });
  TIMES.add(time, { request: direction("request"), response: direction("response"),
    response_times: states.flatMap((net) => net.response_times) });
  TILES.requests.show(rate(TIMES.requests), `${rate(TIMES.answers)} answers`);
  TILES.requests.add(time, TIMES.requests);
  const [median, p99] = [TIMES.quantile(0.5), TIMES.quantile(0.99)];
  TILES.times.show(duration(median), median === null ? "no answers yet" : `median; 99 % within ${duration(p99)} (dashed)`);
  TILES.times.add(time, median, p99);

  const flows = sum((net) => net.flows);
  TILES.flows.show(whole.format(flows), `of ${whole.format(status.max_flows)} at most`);
  TILES.flows.add(time, flows);
  write($("flows-sum"), `${counted(flows, "flow")} now`);
  const droppedRate = RATES.dropped.add(time, total(dropped));
  TILES.dropped.show(rate(droppedRate), `${whole.format(total(dropped))} since the start`);
  TILES.dropped.add(time, droppedRate);
  const wrong = dropped.password_wrong ?? 0;
  const wrongRate = RATES.passwords.add(time, wrong);
  const sources = status.wrong_password_sources;
  const orMore = sources >= status.wrong_password_sources_at_most ? " or more" : "";
  const from = sources === 1 ? "1 address" : `${whole.format(sources)}${orMore} addresses`;
  TILES.passwords.show(whole.format(wrong), wrong ? `from ${from} since the start` : "since the start");
  TILES.passwords.add(time, wrongRate);
}

/** How many of all flows the kernel carries, or why it carries none. */
function inTheKernel({ state, why, flows, interfaces }, all) {
  if (state === "off") return `no: ${why}`;
  const at = interfaces.length ? interfaces.join(", ") : "no interface";
  return `${whole.format(flows)} of ${counted(all, "flow")}, at ${at}`;
}

function showRelay(status, states) {
  const build = status.commit ? `${status.version} (${status.commit})` : status.version;
  const program = status.title ? "pnet-nat " : "";
  write($("title"), status.title ?? "pnet-nat");
  write($("process"), `${program}${build}, up for ${age(status.uptime_seconds)}`);
  const { reload, sandbox, offload } = status;
  const flows = states.reduce((sum, net) => sum + net.flows, 0);
  const inForce = `the configuration in force is ${age(reload.in_force_seconds)} old`;
  const layers = sandbox.map(({ layer, state, why }) => `${layer} ${state}${why ? ` (${why})` : ""}`);
  const [{ why }] = sandbox; // the same of all when none was asked for
  const off = sandbox.every(({ state }) => state === "off");
  const on = sandbox.filter(({ state }) => state === "on").length;
  const facts = [
    ["Relaying", status.ready ? "yes" : "no: it starts or stops"],
    ["Last reload", `${reload.successful ? "successful" : reload.error ? "failed" : "in force in part"}; ${inForce}`],
    ["Confinement", off ? `off ${why}` : `${on} of ${sandbox.length} layers on: ${layers.join(", ")}`],
    ["In the kernel", inTheKernel(offload, flows)],
    ["Size", `${whole.format(status.public_ports)} public ports, ${whole.format(status.workers)} ${status.workers === 1 ? "worker" : "workers"}`],
    ["Stray answers",
      `${whole.format(status.stray_responses.received_datagrams)} datagrams from the plant belong to no node of the table`],
  ];
  const list = $("relay");
  if (!list.children.length) {
    list.append(...facts.flatMap(([title]) => [make("dt", {}, title), make("dd")]));
  }
  facts.forEach(([, text], i) => write(list.children[2 * i + 1], text));
}

