// The status page. Asks the API of this server alone, draws only what changed, and asks for the
// nodes of those nets alone that are open and in sight: 8,000 of them cost no more than 4.
"use strict";

const RATE_SECONDS = 10; // a rate is the mean of this time
const TIMES_SECONDS = 60; // response times weigh 1/e after this time
const PLOT_SECONDS = 300;
const FEW_PORTS = 128; // up to here all nets begin open
const STATES = {
  answering: ["●", "answering"],
  silent: ["▲", "silent"],
  never_asked: ["○", "never asked"],
};

// ── Asking ──────────────────────────────────────────────────────────────────────────────────────

const TOKEN = "pnet-nat token"; // forgotten with the tab
class TokenNeeded extends Error {}

/** What the API says; null where there is nothing. */
async function ask(path) {
  const token = sessionStorage.getItem(TOKEN);
  const headers = token ? { authorization: `Bearer ${token}` } : {};
  const answer = await fetch(path, { headers, signal: AbortSignal.timeout(10_000) });
  if (answer.status === 401) throw new TokenNeeded();
  if (answer.status === 404) return null;
  if (!answer.ok) throw new Error(`${answer.status} ${await answer.text()}`);
  return answer.json();
}

// ── Figures over time ───────────────────────────────────────────────────────────────────────────

/** So many seconds without a look are a pause: what happened then says nothing of now. */
let pause = RATE_SECONDS;

/** The rate of a counter. */
class Rate {
  #samples = [];

  add(time, value) {
    const samples = this.#samples;
    const [before, count] = samples.at(-1) ?? [time, value];
    if (value < count || time - before > pause) samples.length = 0; // it, or we, began anew
    samples.push([time, value]);
    while (samples.length > 2 && samples[1][0] <= time - RATE_SECONDS) samples.shift();
    return this.now;
  }

  /** Null before there are two samples. */
  get now() {
    const [[since, from], [until, to]] = [this.#samples[0], this.#samples.at(-1)];
    return until > since ? (to - from) / (until - since) : null;
  }
}

/** Response times, those of late above all: a histogram that fades. */
class Times {
  #last = null;
  #weights = new Map(); // by upper bound: answers, and the sum of their times

  /** Adds what the API has of one node, of one net, or of several in a row. */
  add(times, elapsed) {
    const now = new Map();
    for (const { up_to_seconds, answers, sum_seconds } of times) {
      const bound = up_to_seconds ?? Infinity;
      const [count, sum] = now.get(bound) ?? [0, 0];
      now.set(bound, [count + answers, sum + sum_seconds]);
    }
    const restarted = [...(this.#last ?? [])].some(([bound, [count]]) => !(now.get(bound)?.[0] >= count));
    if (!this.#last || restarted) {
      // All since the start weighs as much as one answer, until there are others.
      const all = [...now.values()].reduce((all, [count]) => all + count, 0);
      this.#weights = new Map([...now].map(([bound, [count, sum]]) => [bound, [count / all, sum / all]]));
    } else {
      const fade = Math.exp(-elapsed / TIMES_SECONDS);
      for (const [bound, [count, sum]] of now) {
        const [weight, time] = this.#weights.get(bound) ?? [0, 0];
        const [counted, summed] = elapsed > pause ? [count, sum] : this.#last.get(bound) ?? [0, 0];
        this.#weights.set(bound, [weight * fade + (count - counted), time * fade + (sum - summed)]);
      }
    }
    this.#last = now;
  }

  /** Seconds, as the API has it: the mean of a bucket, of which two digits are true. Null without
   * answers. */
  quantile(share) {
    const buckets = [...this.#weights].sort(([a], [b]) => a - b);
    const all = buckets.reduce((all, [, [weight]]) => all + weight, 0);
    let below = 0;
    for (const [bound, [weight, time]] of buckets) {
      below += weight;
      if (weight > 0 && below >= share * all) return Math.min(time / weight, bound);
    }
    return null;
  }
}

// ── Words ───────────────────────────────────────────────────────────────────────────────────────

const whole = new Intl.NumberFormat("en");
const short = new Intl.NumberFormat("en", { maximumSignificantDigits: 3 });
const rough = new Intl.NumberFormat("en", { maximumSignificantDigits: 2 });

const rate = (value) => (value === null ? "–" : `${short.format(value)} /s`);

function duration(seconds) {
  if (seconds === null) return "–";
  return seconds < 1 ? `${rough.format(seconds * 1000)} ms` : `${rough.format(seconds)} s`;
}

function age(seconds) {
  for (const [unit, length] of [["d", 86400], ["h", 3600], ["min", 60]]) {
    if (seconds >= 2 * length) return `${Math.floor(seconds / length)} ${unit}`;
  }
  return seconds < 10 ? `${seconds.toFixed(1)} s` : `${Math.floor(seconds)} s`;
}

const nodes = (count) => (count === 1 ? "1 node" : `${whole.format(count)} nodes`);

// ── Drawing ─────────────────────────────────────────────────────────────────────────────────────

const $ = (id) => document.getElementById(id);

function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

/** Touches the page only where something changed. */
function write(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** Has these elements in a place, in this order; those that stay are not moved. */
function arrange(place, elements) {
  const wanted = new Set(elements);
  for (const child of [...place.children]) if (!wanted.has(child)) child.remove();
  for (const [i, element] of elements.entries()) {
    if (place.children[i] !== element) place.insertBefore(element, place.children[i] ?? null);
  }
}

function svg(tag, attributes = {}) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  return element;
}

/** A headed figure with a plot of the last minutes. */
class Tile {
  #points = [];
  #paths = [];

  constructor(title, { lines = 0, unit = (value) => short.format(value) } = {}) {
    this.title = title;
    this.unit = unit;
    this.value = make("p", { class: "value" });
    this.note = make("p", { class: "note" });
    const tile = make("div", { class: "tile" }, make("h3", {}, title), this.value, this.note);
    if (lines) {
      this.plot = svg("svg", { class: "plot", viewBox: "0 0 100 40", role: "img",
        preserveAspectRatio: "none" });
      this.plot.append(svg("line", { x1: 0, y1: 39.5, x2: 100, y2: 39.5 }));
      for (let i = 0; i < lines; i += 1) {
        this.#paths.push(svg("path", { class: i ? "second" : "first" }));
        this.plot.append(this.#paths[i]);
      }
      this.most = make("span");
      const axis = make("p", { class: "axis" }, "−5 min", this.most, "now");
      tile.append(this.plot, axis);
    }
    $("tiles").append(tile);
  }

  show(value, note) {
    write(this.value, value);
    write(this.note, note);
  }

  /** Adds a point to each line. */
  add(time, ...values) {
    this.#points.push([time, values]);
    while (this.#points[0][0] < time - PLOT_SECONDS) this.#points.shift();
    const most = Math.max(0, ...this.#points.flatMap(([, values]) => values));
    for (const [i, path] of this.#paths.entries()) {
      let pen = "M";
      const draw = ([at, values]) => {
        if (values[i] === null) return "";
        const x = 100 - (100 * (time - at)) / PLOT_SECONDS;
        const y = 39 - (most ? (37 * values[i]) / most : 0);
        const step = `${pen}${x.toFixed(2)} ${y.toFixed(2)}`;
        pen = "L";
        return step;
      };
      path.setAttribute("d", this.#points.map(draw).join(""));
    }
    write(this.most, most ? `max ${this.unit(most)}` : "");
    const label = `${this.title} of the last 5 minutes: at most ${this.unit(most)}`;
    if (this.plot.getAttribute("aria-label") !== label) this.plot.setAttribute("aria-label", label);
  }
}

const TILES = {
  nodes: new Tile("Nodes that answer", { lines: 1 }),
  requests: new Tile("Requests passed on", { lines: 1, unit: rate }),
  times: new Tile("Response time", { lines: 2, unit: duration }),
  flows: new Tile("Flows", { lines: 1 }),
  dropped: new Tile("Dropped", { lines: 1, unit: rate }),
  passwords: new Tile("Wrong passwords", { lines: 1, unit: rate }),
};

/** How often datagrams were dropped, by reason: of both directions of one place. */
function drops(...directions) {
  const sums = {};
  for (const { dropped_datagrams } of directions) {
    for (const [reason, count] of Object.entries(dropped_datagrams)) {
      sums[reason] = (sums[reason] ?? 0) + count;
    }
  }
  return sums;
}

/** Why requests were not passed on, most frequent first, in words; empty when all were. */
function refusals(...requests) {
  const reasons = Object.entries(drops(...requests)).sort(([, a], [, b]) => b - a);
  const sum = total(Object.fromEntries(reasons));
  const counted = sum === 1 ? "1 request" : `${whole.format(sum)} requests`;
  return sum ? `${counted} refused: ${reasons.map(([reason]) => reason).join(", ")}` : "";
}

/** What the kernel dropped, by the names that `reasons` has for it. */
const named = (place, causes) => ({
  dropped_datagrams: Object.fromEntries(
    Object.entries(causes).map(([cause, count]) => [place + cause, count])),
});

const total = (counts) => Object.values(counts).reduce((a, b) => a + b, 0);

/** What a net and a node have in common. */
class Traffic {
  #requests = new Rate();
  #answers = new Rate();
  #times = new Times();
  #before = null;

  add(time, state) {
    this.requests = this.#requests.add(time, state.request.forwarded_datagrams);
    this.answers = this.#answers.add(time, state.response.forwarded_datagrams);
    this.#times.add(state.response_times, time - (this.#before ?? time));
    this.#before = time;
  }

  quantile(share) {
    return this.#times.quantile(share);
  }
}

/** Columns of figures; on a phone they stand beside the figures. */
const FIGURES = ["Requests", "Answers", "Median", "99 %", "Dropped"];

/** A row of a net's table. */
class NodeRow {
  traffic = new Traffic();

  constructor(node) {
    this.node = node.node;
    const place = make("small", {}, `${node.public_port} → ${node.server}`);
    const head = make("th", { scope: "row" }, `${node.node}`, place);
    this.mark = make("span", { "aria-hidden": "true" });
    this.word = make("span");
    this.since = make("small");
    this.state = make("td", {}, this.mark, " ", this.word, this.since);
    this.figures = FIGURES.map((title) =>
      make("td", { class: "number", "data-title": title }, make("span")));
    this.why = make("small");
    this.figures.at(-1).append(this.why);
    this.row = make("tr", { "data-node": node.node }, head, this.state, ...this.figures);
  }

  show(time, node) {
    this.traffic.add(time, node);
    const [mark, word] = STATES[node.state];
    if (this.state.className !== node.state) this.state.className = node.state;
    write(this.mark, mark);
    write(this.word, word);
    const [asked, answered] = [node.last_request_age_seconds, node.last_response_age_seconds];
    const no_answer = asked === null ? "" : "no answer so far";
    write(this.since, answered === null ? no_answer : `last answer ${age(answered)} ago`);
    const dropped = drops(node.request, node.response);
    const refused = node.state === "never_asked" ? refusals(node.request) : "";
    if (refused) {
      this.state.className = "refused";
      write(this.mark, "▲");
      write(this.word, "requests refused");
      write(this.since, refused);
    }
    const texts = [
      rate(this.traffic.requests),
      rate(this.traffic.answers),
      duration(this.traffic.quantile(0.5)),
      duration(this.traffic.quantile(0.99)),
      whole.format(total(dropped)),
    ];
    texts.forEach((text, i) => write(this.figures[i].firstChild, text));
    const why = Object.entries(dropped).map(([reason, count]) => `${reason}: ${count}`);
    write(this.why, why.join(", "));
  }
}

/** A net: a line, and below it, while it is open, its nodes. */
class NetView {
  traffic = new Traffic();
  rows = new Map();
  inSight = false;
  looking = false;
  wanted = null; // the node to go to when the nodes are drawn

  constructor(net, open) {
    this.name = net.name;
    this.states = new Map();
    for (const state of Object.keys(STATES)) {
      this.states.set(state, make("span", { class: state }));
    }
    const figures = () => make("span", { class: "figure" });
    this.figures = [figures(), figures(), figures(), figures()];
    const name = make("b", {}, net.name);
    this.summary = make("summary", {}, name, ...this.states.values(), ...this.figures);
    this.body = make("tbody");
    const column = (title, style) => make("th", { scope: "col", class: style }, title);
    const columns = [column("Node", ""), column("State", ""),
      ...FIGURES.map((title) => column(title, "number"))];
    const table = make("table", { "aria-label": `Nodes of ${net.name}` },
      make("thead", {}, make("tr", {}, ...columns)), this.body);
    const region = { class: "table", tabindex: "0", role: "region",
      "aria-label": `Nodes of ${net.name}` };
    this.details = make("details", { class: "net", "data-net": net.name }, this.summary,
      make("div", region, table));
    this.details.open = open;
    this.details.addEventListener("toggle", () => {
      if (this.details.open && this.inSight) return this.look();
      if (this.details.open) return;
      this.wanted = null;
      this.rows.clear();
      this.body.replaceChildren();
    });
  }

  show(time, net) {
    this.traffic.add(time, net);
    const silent = net.silent_nodes.length;
    const counts = { answering: net.answering_nodes, silent, never_asked: net.never_asked_nodes };
    for (const [state, count] of Object.entries(counts)) {
      const [mark, word] = STATES[state];
      this.states.get(state).hidden = count === 0;
      write(this.states.get(state), `${mark} ${whole.format(count)} ${word}`);
    }
    const [median, p99] = [this.traffic.quantile(0.5), this.traffic.quantile(0.99)];
    const texts = [
      `${rate(this.traffic.requests)} requests`,
      median === null ? "no answers yet" : `${duration(median)} median, ${duration(p99)} 99 %`,
      `${whole.format(net.flows)} of ${whole.format(net.max_flows)} flows`,
      `${whole.format(total(drops(net.request, net.response)))} dropped`,
    ];
    texts.forEach((text, i) => write(this.figures[i], text));
  }

  /** Asks for the nodes and shows them. */
  async look() {
    if (this.looking) return;
    this.looking = true;
    try {
      const answer = await ask(`api/v1/nets?net=${encodeURIComponent(this.name)}`);
      const shown = answer && this.details.open; // a reload may have taken the net
      if (shown) this.showNodes(performance.now() / 1000, answer.nets[0].nodes);
    } catch {
      // The next round tells what is wrong.
    } finally {
      this.looking = false;
    }
  }

  showNodes(time, states) {
    const before = this.rows;
    this.rows = new Map();
    for (const state of states) {
      const key = `${state.node} ${state.public_port} ${state.server}`;
      const row = before.get(key) ?? new NodeRow(state);
      this.rows.set(key, row);
      row.show(time, state);
    }
    arrange(this.body, [...this.rows.values()].map(({ row }) => row));
    this.goToWanted();
  }

  /** Goes to the node that was asked for; to the net when it has that node no more. */
  goToWanted() {
    if (this.wanted === null) return;
    const found = [...this.rows.values()].find(({ node }) => node === this.wanted);
    this.wanted = null;
    const place = found?.row ?? this.summary;
    if (found) place.setAttribute("tabindex", "-1");
    place.scrollIntoView({ block: "center" });
    place.focus({ preventScroll: true });
  }
}

let reasons = null;
const nets = new Map();
const sight = new IntersectionObserver((entries) => {
  for (const { target, isIntersecting } of entries) {
    const net = nets.get(target.dataset.net);
    if (!net) continue;
    const appears = isIntersecting && !net.inSight;
    net.inSight = isIntersecting;
    if (appears && net.details.open && !net.rows.size) net.look();
  }
});

function showNets(time, states, status) {
  const before = new Map(nets);
  nets.clear();
  for (const state of states) {
    let net = before.get(state.name);
    if (!net) {
      net = new NetView(state, status.public_ports <= FEW_PORTS);
      sight.observe(net.details);
    }
    nets.set(state.name, net);
    net.show(time, state);
  }
  arrange($("nets"), [...nets.values()].map(({ details }) => details));
}

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

// ── Round after round ───────────────────────────────────────────────────────────────────────────

let timer = 0;
let running = false;
let last = null; // the last answers, and the time of day

async function poll() {
  reasons ??= await ask("api/v1/drop-reasons");
  const [status, { nets: states }] =
    await Promise.all([ask("api/v1/status"), ask("api/v1/nets?nodes=false")]);
  const time = performance.now() / 1000;
  last = { status, states, at: new Date().toLocaleTimeString() };
  $("status").hidden = false;
  $("status").className = "";
  $("token-form").hidden = true;
  const dropped = drops(status.stray_responses,
    ...states.flatMap(({ request, response }) => [request, response]));
  const kernel = drops(
    ...states.map((net) => named("kernel: ", net.kernel_dropped_datagrams)),
    named("kernel: upstream ", status.upstream_kernel_dropped_datagrams));
  showBanner(status, states, null);
  showTiles(time, status, states, dropped);
  showNets(time, states, status);
  showDrops(time, { ...dropped, ...kernel });
  showRelay(status);
  for (const net of nets.values()) {
    if (net.details.open && net.inSight) await net.look();
  }
}

async function round() {
  clearTimeout(timer);
  if (document.hidden || running) return; // `visibilitychange` wakes it up
  running = true;
  const began = performance.now();
  try {
    await poll();
  } catch (error) {
    if (error instanceof TokenNeeded) {
      running = false;
      return askForToken();
    }
    if (last) {
      $("status").className = "stale";
      showBanner(last.status, last.states, last.at);
    } else {
      write($("process"), `No answer: ${error.message}`);
    }
  }
  running = false;
  // A relay or browser that is slow is asked less often.
  const wait = Math.max(2000, 10 * (performance.now() - began));
  pause = Math.max(RATE_SECONDS, (3 * wait) / 1000);
  timer = setTimeout(round, wait);
}

function askForToken() {
  const refused = sessionStorage.getItem(TOKEN) !== null;
  sessionStorage.removeItem(TOKEN);
  $("status").hidden = true;
  $("token-form").hidden = false;
  write($("token-error"), refused ? "This is not the token." : "");
  $("token").focus();
}

$("token-form").addEventListener("submit", (event) => {
  event.preventDefault();
  sessionStorage.setItem(TOKEN, $("token").value.trim());
  $("token").value = "";
  round();
});
document.addEventListener("visibilitychange", () => {
  if ($("token-form").hidden) round(); // without the token there is nothing to ask
});
round();
