// ── Nets and their nodes ────────────────────────────────────────────────────────────────────────

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
    const at = node.local_address === null ? "" : `${node.local_address}:`;
    const place = make("small", {}, `${at}${node.public_port} → ${node.server}`);
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

