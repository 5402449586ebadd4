// ── The relay as a whole ────────────────────────────────────────────────────────────────────────

const RATES = { requests: new Rate(), dropped: new Rate(), passwords: new Rate() };
const TIMES = new Traffic();
const REASON_RATES = new Map();

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
  TILES.times.show(duration(median), `median; 99 % within ${duration(p99)} (dashed)`);
  TILES.times.add(time, median, p99);

  const flows = sum((net) => net.flows);
  TILES.flows.show(whole.format(flows), `of ${whole.format(status.max_flows)} at most`);
  TILES.flows.add(time, flows);
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

function showDrops(time, dropped) {
  const rates = new Map();
  for (const reason of Object.keys(reasons)) {
    if (!REASON_RATES.has(reason)) REASON_RATES.set(reason, new Rate());
    rates.set(reason, REASON_RATES.get(reason).add(time, dropped[reason] ?? 0));
  }
  const rows = Object.entries(dropped).filter(([, count]) => count).sort(([, a], [, b]) => b - a);
  $("no-drops").hidden = rows.length > 0;
  $("drops").hidden = rows.length === 0;
  const body = $("drops").tBodies[0];
  while (body.rows.length > rows.length) body.lastChild.remove();
  for (const [i, [reason, count]] of rows.entries()) {
    if (!body.rows[i]) {
      body.append(make("tr", {}, make("th", { scope: "row" }, make("code")),
        make("td", { class: "number" }), make("td", { class: "number" }), make("td")));
    }
    const [name, sum, perSecond, meaning] = body.rows[i].cells;
    write(name.firstChild, reason);
    write(sum, whole.format(count));
    write(perSecond, rate(rates.get(reason) ?? null));
    write(meaning, (reasons[reason] ?? "").replaceAll("`", ""));
  }
}

function showRelay(status) {
  const build = status.commit ? `${status.version} (${status.commit})` : status.version;
  write($("process"), `${build}, up for ${age(status.uptime_seconds)}`);
  const { reload, sandbox } = status;
  const inForce = `the configuration in force is ${age(reload.in_force_seconds)} old`;
  const layers = sandbox.map(({ layer, state, why }) => `${layer} ${state}${why ? ` (${why})` : ""}`);
  const on = sandbox.filter(({ state }) => state === "on").length;
  const facts = [
    ["Relaying", status.ready ? "yes" : "no: it starts or stops"],
    ["Last reload", `${reload.successful ? "successful" : reload.error ? "failed" : "in force in part"}; ${inForce}`],
    ["Confinement", `${on} of ${sandbox.length} layers on: ${layers.join(", ")}`],
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

const SHOWN_SILENT = 12;
let bannerKey = "";

function showBanner(status, states, lost) {
  const silent = states.flatMap((net) => net.silent_nodes.map((node) => [net.name, node]));
  const answering = states.reduce((sum, net) => sum + net.answering_nodes, 0);
  const lines = [];
  if (lost) lines.push(`The relay has not answered since ${lost}. These are its last figures.`);
  if (!status.ready) lines.push("The relay is not relaying: it starts or stops.");
  if (!status.reload.successful) {
    const { error, faults, not_in_force: items } = status.reload;
    if (error) {
      lines.push(`The last reload failed, and the configuration before it is in force: ${error}`, ...faults);
    }
    lines.push(...items.map(({ what, why }) => `Not in force: ${what}: ${why}`));
  }
  if (silent.length) lines.push(`▲ ${silent.length === 1 ? "1 node is" : `${nodes(silent.length)} are`} silent:`);
  const bad = lines.length > 0;
  // Requests came, and no node has answered any: then it is no good sign that none is silent.
  const refused = answering ? "" : refusals(...states.map((net) => net.request));
  if (!bad && refused) {
    lines.push(`▲ No client has had an answer yet: ${refused}. Below it says what that means.`);
  } else if (!bad) {
    lines.push(answering ? `● ${answering === 1 ? "The one node" : `All ${nodes(answering)}`} that clients asked ${answering === 1 ? "answers" : "answer"}.`
      : "○ Relaying. No client has had an answer yet.");
  }
  document.title = silent.length ? `${whole.format(silent.length)} silent · pnet-nat` : "pnet-nat";
  const key = JSON.stringify([lines, silent.slice(0, SHOWN_SILENT), silent.length]);
  if (key === bannerKey) return;
  bannerKey = key;
  const banner = $("banner");
  banner.className = bad ? "bad" : refused ? "doubtful" : "good";
  banner.replaceChildren(...lines.map((line) => make("p", {}, line)));
  if (!silent.length) return;
  const links = make("p");
  for (const [name, node] of silent.slice(0, SHOWN_SILENT)) {
    const link = make("button", { type: "button" }, `${name}, node ${node}`);
    link.addEventListener("click", () => find(name, node));
    links.append(link);
  }
  const rest = silent.length - SHOWN_SILENT;
  if (rest > 0) links.append(`and ${whole.format(rest)} more. `);
  const help = make("button", { type: "button" }, "What to do");
  help.addEventListener("click", () => {
    $("help").open = true;
    $("help").scrollIntoView();
    $("help").firstElementChild.focus();
  });
  links.append(help);
  banner.append(links);
}

/** Opens a net and goes to one of its nodes, as soon as that is drawn. */
function find(name, node) {
  const net = nets.get(name);
  if (!net) return;
  net.wanted = node;
  net.details.open = true;
  net.look();
}

