// ── Nets ────────────────────────────────────────────────────────────────────────────────────────

/** A net: a line, and below it, while it is open, its nodes. */
class NetView {
  traffic = new Traffic();
  rows = new Map();
  inSight = false;
  looking = false;
  wanted = null; // the node to go to when the nodes are drawn
  silent = new Set();
  stripsAt = -Infinity; // when the states of the day were asked for
  wasOpen = null; // before the filter

  constructor(net, open, canProbe) {
    this.name = net.name;
    this.canProbe = canProbe;
    this.states = new Map();
    for (const state of Object.keys(STATES)) {
      this.states.set(state, make("span", { class: state }));
    }
    const figures = () => make("span", { class: "figure" });
    this.figures = [figures(), figures(), figures(), figures()];
    const name = make("b", {}, net.name);
    const states = make("span", { class: "states" }, ...this.states.values());
    this.summary = make("summary", {}, name, states, ...this.figures);
    this.body = make("tbody", { class: "folded" });
    const column = (title, style) => make("th", { scope: "col", class: style }, title);
    const columns = [column("Node", ""), column("State", ""),
      column("24 hours", "day"), ...FIGURES.map((title) => column(title, "number"))];
    this.fold = make("button", { type: "button", class: "fold", "aria-expanded": "false" });
    this.fold.addEventListener("click", () => {
      const isFolded = this.body.classList.toggle("folded");
      this.fold.setAttribute("aria-expanded", !isFolded);
    });
    const table = make("table", { "aria-label": `Nodes of ${net.name}` },
      make("thead", {}, make("tr", {}, ...columns)), this.body);
    const region = { class: "table", tabindex: "0", role: "region",
      "aria-label": `Nodes of ${net.name}` };
    this.details = make("details", { class: "net", "data-net": net.name }, this.summary,
      make("div", region, table), this.fold);
    this.details.open = open;
    this.details.addEventListener("toggle", () => {
      if (this.details.open && this.inSight) return this.look();
      if (this.details.open) return;
      this.wanted = null;
      this.stripsAt = -Infinity;
      this.rows.clear();
      this.body.replaceChildren();
    });
  }

  show(time, net) {
    this.traffic.add(time, net);
    this.silent = new Set(net.silent_nodes);
    write(this.fold, `${whole.format(net.answering_nodes)} answering`);
    this.fold.hidden = !net.answering_nodes;
    const counts = { silent: this.silent.size, answering: net.answering_nodes, never_asked: net.never_asked_nodes };
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
      if (!shown) return;
      const time = performance.now() / 1000;
      this.showNodes(time, answer.nets[0].nodes);
      if (time - this.stripsAt >= 60) await this.showStrips(time);
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
      const row = before.get(key) ?? new NodeRow(this.name, state, this.canProbe);
      this.rows.set(key, row);
      row.show(time, state);
    }
    const sorted = [...this.rows.values()].sort((a, b) => a.rank - b.rank || a.node - b.node);
    arrange(this.body, sorted.flatMap(({ rows }) => rows));
    if (this.rows.size !== before.size) this.stripsAt = -Infinity; // some have none yet
    this.goToWanted();
  }

  /** How the nodes were over the day. */
  async showStrips(time) {
    this.stripsAt = time;
    const answer = await ask(`api/v1/history?net=${encodeURIComponent(this.name)}`);
    for (const row of this.rows.values()) {
      const letters = answer?.nodes[row.node];
      if (letters) row.strip.show(time, letters);
    }
  }

  /** Shows itself when the filter leaves one of its nodes; says how many. */
  filter(opens) {
    const count = wantedOf(this.name, this.silent);
    this.details.hidden = count === 0;
    if (opens) {
      this.wasOpen ??= this.details.open;
      this.details.open = count > 0;
      if (count > 0 && this.inSight) this.look();
    }
    return count;
  }

  unfilter() {
    this.details.hidden = false;
    if (this.wasOpen !== null) this.details.open = this.wasOpen;
    this.wasOpen = null;
    if (this.rows.size) this.look();
    return 0;
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
      net = new NetView(state, status.public_ports <= FEW_PORTS, status.probe);
      sight.observe(net.details);
    }
    nets.set(state.name, net);
    if (net.canProbe !== status.probe) net.rows.clear(); // they are made anew
    net.canProbe = status.probe;
    net.show(time, state);
  }
  arrange($("nets"), [...nets.values()].map(({ details }) => details));
}

/** Opens a net and goes to one of its nodes, as soon as that is drawn. */
async function find(name, node) {
  if (filterWords.length) {
    $("filter").value = "";
    await setFilter("");
  }
  const net = nets.get(name);
  if (!net) return;
  net.wanted = node;
  net.details.open = true;
  net.look();
}

